"""What a page can show: the robots of a run, or two behaviors to compare."""

import time
from collections.abc import Sequence
from typing import Any, Protocol

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...networks.policy import Policy
from ...runs.loading import bookmark, bookmarks, own_folder
from . import library, messages
from .asking import Asking
from .behavior import Behavior
from .bodies import Bodies
from .comparisons import Comparisons, PolicyComparisons
from .lineup import Lineup
from .messages import Request
from .requests import Put
from .saving import Saving
from .session import Session, Weights
from .thresholds import Thresholds

SCAN = 3.0  # s between searches for new runs
NO_FRONT = "This checkpoint has no front. To write one: morlax evaluate RUN"


class Exhibit(Protocol):
    """Robots, and what users may do with them."""

    @property
    def behaviors(self) -> Sequence[Behavior]:
        """The robots to move and show, at least one; of equal models."""
        ...

    def state(self) -> dict[str, Any]:
        """Describe everything that can change, apart from poses; JSON."""
        ...

    def react(self, request: Request) -> None:
        """Do what a user asks for.

        Raises:
            MorlaxError: it cannot be done; everything is as before.
        """
        ...


class ComparisonExhibit:
    """Two behaviors of a source of questions; it must have at least one question."""

    def __init__(self, source: Comparisons):
        self._asking = Asking(source)
        self.behaviors = self._asking.behaviors

    def state(self) -> dict[str, Any]:
        return {"asking": self._asking.state()}

    def react(self, request: Request) -> None:
        answer(self._asking, request)
        if isinstance(request, messages.Press) and request.name == "reset":
            for behavior in self.behaviors:
                behavior.reset()
        self.behaviors = self._asking.behaviors or self.behaviors  # the last ones stay


class RunExhibit:
    """A run's robots: one, several to compare, or the two of "A or B?".

    Args:
        choice: the checkpoint to show.
        put: queues what other threads have found.

    Raises:
        MorlaxError: the checkpoint is missing or damaged, or the task has no MuJoCo robot.
    """

    def __init__(self, choice: library.Choice, put: Put):
        self._put, self._scanned = put, -SCAN
        self._labels: list[str] = []  # of runs to choose from
        self._open(choice, Session.open(choice))

    @property
    def behaviors(self) -> Sequence[Behavior]:
        return (self._asking and self._asking.behaviors) or self._lineup.sessions

    def state(self) -> dict[str, Any]:
        return {
            "runs": self._runs(),
            "run": self._choice.run,
            "checkpoint": self._choice.checkpoint,
            "checkpoints": list(self._choice.files),
            "selected": self._lineup.selected,
            "command": list(self._lineup.steered.player.command),
            "design": self._lineup.steered.design,
            "measured": self._bodies is None or not self._bodies.changed,
            "choosing": self._thresholds.state() if self._thresholds else None,
            "asking": self._asked(),
            "bookmarks": self._bookmarks,
            "saving": self._saving.state(),
        }

    def react(self, request: Request) -> None:
        steered, thresholds = self._lineup.steered, self._thresholds
        m = len(steered.objectives)
        match request:
            case messages.Steer(weights=weights) if len(weights) == m:
                self._steer(normalized(weights) or steered.tradeoff)
            case messages.Tell(index=index) if index < len(steered.player.command):
                for session in self._sessions():
                    session.tell(index, request.value)
            case messages.Nudge(index=index) if index < len(steered.player.command):
                for session in self._sessions():
                    session.tell(index, session.player.command[index] + request.change)
            case messages.Reshape(index=index) if self._bodies and index < len(steered.design):
                self._asking = self._source = self._thresholds = None
                self._bodies.reshape(self._lineup.sessions, index, request.value)
            case messages.Select(robot=robot) if robot < len(self._lineup.sessions):
                self._lineup.selected = robot
            case messages.Open(run=run, checkpoint=checkpoint) if run in self._runs():
                choice = library.choose(run, checkpoint)
                self._open(choice, self._alike(Session.open(choice)))
            case messages.Require(index=index) if thresholds and index < len(thresholds.names):
                thresholds.require(index, request.level)
            case messages.Maximize(index=index) if thresholds and index < len(thresholds.names):
                thresholds.maximize(index)
            case messages.Bookmark(name=name):
                bookmark(self._choice.run, name, steered.tradeoff)
                self._bookmarks = bookmarks(self._choice.run)
            case messages.Press(name=name):
                self._press(name)
        if self._asking is not None:
            answer(self._asking, request)

    def _runs(self) -> dict[str, str]:
        """Return the runs to choose from: how each is called in a list, by its name."""
        if time.monotonic() > self._scanned + SCAN:
            self._scanned, self._labels = time.monotonic(), library.labels()
        listed = {library.named(label): label for label in self._labels}
        return {self._choice.run: self._choice.run, **listed}

    def _open(self, choice: library.Choice, session: Session) -> None:
        self._choice, self._lineup = choice, Lineup(session)
        self._saving = Saving(choice, self._put)
        # shipped policies keep none
        self._bookmarks = bookmarks(choice.run) if own_folder(choice.run) else None
        self._asking: Asking | None = None
        self._source: PolicyComparisons | None = None
        self._rounds = 0
        self._bodies = Bodies(self._put, self._measured) if session.design else None
        self._choose_from(session)

    def _choose_from(self, session: Session) -> None:
        """Offer thresholds to a robot's front, if it has one."""
        self._thresholds = None
        if session.front is not None:
            policy, lower = session.player.policy, session.player.env.lower_is_better
            self._thresholds = Thresholds(policy, session.front, self._put, self._steer, lower)

    def _measured(self, policy: Policy, front: Front) -> bool:
        """Show the front of a body, unless the robots have another one by now."""
        if self._lineup.steered.player.policy is not policy:
            return False
        for session in self._lineup.sessions:
            session.measured(front)
        self._choose_from(self._lineup.steered)
        return True

    def _alike(self, session: Session) -> Session:
        """Give a robot of another checkpoint what the present one has."""
        old = self._lineup.steered
        if session.objectives == old.objectives:
            session.tradeoff = old.tradeoff
        if session.player.env.command_limits == old.player.env.command_limits:
            session.player.command = list(old.player.command)
        if self._thresholds is not None:
            self._thresholds.stop()
        return session

    def _steer(self, tradeoff: Weights) -> None:
        self._lineup.steered.tradeoff = tradeoff

    def _press(self, name: str) -> None:
        match name:
            case "reset":
                for behavior in self.behaviors:
                    behavior.reset()
            case "push":
                for session in self._sessions():
                    session.push()
            case "add":
                self._lineup.add()
            case "remove":
                self._lineup.remove()
            case "free" if self._thresholds is not None:
                self._thresholds.stop()
            case "measure" if self._bodies is not None:
                self._bodies.measure(self._lineup.steered)
            case "export":
                self._saving.export(self._lineup.steered.tradeoff, self._lineup.steered.reshaped)
            case "card" if self._thresholds is not None:
                self._saving.card(self._thresholds.options())
            case "find" | "again":
                self._find()
            case "use" | "leave":
                if name == "use" and self._source is not None:
                    self._steer(self._source.best()[1])
                self._asking = self._source = None

    def _find(self) -> None:
        """Begin with "A or B?", or begin anew."""
        steered = self._lineup.steered
        if steered.front is None:
            raise MorlaxError(NO_FRONT)
        robots = steered.twin(), steered.twin()
        self._source = PolicyComparisons(steered.front, robots, seed=self._rounds)
        self._asking = Asking(self._source)
        self._rounds += 1

    def _asked(self) -> dict[str, Any] | None:
        if self._asking is None or self._source is None:
            return None
        return {**self._asking.state(), **self._source.state()}

    def _sessions(self) -> list[Session]:
        shown = [b for b in self.behaviors if isinstance(b, Session)]
        return list({*self._lineup.sessions, *shown})


def answer(asking: Asking, request: Request) -> None:
    """Hand an answer to whoever asked."""
    match request:
        case messages.Answer(preferred=preferred):
            asking.answer(preferred)
        case messages.Press(name="skip"):
            asking.skip()


def normalized(weights: Sequence[float]) -> Weights | None:
    """Scale a trade-off to sum to one; None if it is invalid: negative, or all zero."""
    total = sum(weights)
    if min(weights) < 0 or not 0 < total < float("inf"):
        return None
    return tuple(weight / total for weight in weights)
