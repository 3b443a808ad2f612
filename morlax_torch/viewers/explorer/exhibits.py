"""The exhibits of a page: the robots of a run, or two behaviors to compare."""

import time
from collections.abc import Sequence
from typing import Any, Protocol

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...runs.loading import bookmark, bookmarks, own_folder
from . import library
from .comparisons import Asking, Comparisons, PolicyComparisons
from .lineup import Lineup, Thresholds
from .saving import Saving
from .session import Behavior, Put, Session, Weights

SCAN = 3.0  # s between searches for new runs
Request = dict[str, Any]  # "act", and the fields of that act


class Exhibit(Protocol):
    """Robots, and what users may do with them.

    `behaviors` are at least one, of equal models. `state` describes everything that can change,
    apart from poses, as JSON. `react` fulfills a user's request, or raises MorlaxError and changes
    nothing.
    """

    @property
    def behaviors(self) -> Sequence[Behavior]: ...

    def state(self) -> dict[str, Any]: ...

    def react(self, request: Request) -> None: ...


class ComparisonExhibit:
    """Two behaviors of a source of questions; it must have at least one question."""

    def __init__(self, source: Comparisons):
        self._asking = Asking(source)
        self.behaviors = self._asking.behaviors

    def state(self) -> dict[str, Any]:
        return {"asking": self._asking.state()}

    def react(self, request: Request) -> None:
        self._asking.react(request)
        if request.get("name") == "reset":
            for behavior in self.behaviors:
                behavior.reset()
        self.behaviors = self._asking.behaviors or self.behaviors  # the last ones stay


class RunExhibit:
    """A run's robots: one, several to compare, or the two of "A or B?".

    `put` queues calls of other threads that use the robots. For errors see `Session.open`.
    """

    def __init__(self, choice: library.Choice, put: Put):
        self._put, self._scanned = put, -SCAN
        self._labels: dict[str, str] = {}  # of runs to choose from
        self._open(choice, Session.open(choice))

    @property
    def behaviors(self) -> Sequence[Behavior]:
        return (self._asking and self._asking.behaviors) or self._lineup.sessions

    def state(self) -> dict[str, Any]:
        steered, thresholds, asking = self._lineup.steered, self._thresholds(), None
        if self._asking is not None and self._source is not None:
            asking = {**self._asking.state(), **self._source.state()}
        return {
            "runs": self._runs(),
            "run": self._choice.run,
            "checkpoint": self._choice.checkpoint,
            "checkpoints": list(self._choice.files),
            "selected": self._lineup.selected,
            "command": list(steered.player.command),
            "design": steered.design,
            "measured": not self._lineup.stale,
            "choosing": thresholds and thresholds.state(),
            "asking": asking,
            "bookmarks": self._bookmarks,
            "saving": self._saving.state(),
        }

    def react(self, request: Request) -> None:
        lineup, thresholds = self._lineup, self._thresholds()
        steered, command = lineup.steered, lineup.steered.player.command
        shown = [each for each in self.behaviors if isinstance(each, Session)]
        sessions = {*lineup.sessions, *shown}
        match request:
            case {"act": "steer", "weights": weights} if len(weights) == len(steered.objectives):
                total = sum(weights)
                if min(weights) >= 0 and 0 < total < float("inf"):
                    self._steer(tuple(weight / total for weight in weights))
            case {"act": "tell", "index": i, "value": value} if i < len(command):
                for session in sessions:
                    session.tell(i, value)
            case {"act": "nudge", "index": i, "change": change} if i < len(command):
                for session in sessions:
                    session.tell(i, session.player.command[i] + change)
            case {"act": "reshape", "index": i, "value": value} if i < len(steered.design):
                self._asking = self._source = None
                lineup.reshape(i, value)
            case {"act": "select", "robot": robot} if robot < len(lineup.sessions):
                lineup.selected = robot
            case {"act": "open", "run": run, "checkpoint": checkpoint} if run in self._runs():
                choice = library.choose(run, checkpoint)
                session = Session.open(choice)
                if session.objectives == steered.objectives:
                    session.tradeoff = steered.tradeoff
                if session.player.env.command_limits == steered.player.env.command_limits:
                    session.player.command = list(command)
                if thresholds is not None:
                    thresholds.stop()
                self._open(choice, session)
            case {"act": "require", "index": i} if thresholds and i < len(thresholds.names):
                thresholds.require(i, request["level"])
            case {"act": "maximize", "index": i} if thresholds and i < len(thresholds.names):
                thresholds.maximize(i)
            case {"act": "bookmark", "name": name}:
                bookmark(self._choice.run, name, steered.tradeoff)
                self._bookmarks = bookmarks(self._choice.run)
            case {"name": "reset"}:
                for behavior in self.behaviors:
                    behavior.reset()
            case {"name": "push"}:
                for session in sessions:
                    session.push()
            case {"name": "add"}:
                lineup.add()
            case {"name": "remove"}:
                lineup.remove()
            case {"name": "free"} if thresholds is not None:
                thresholds.stop()
            case {"name": "measure"} if lineup.stale:
                lineup.measure()
            case {"name": "export"}:
                self._saving.export(steered.tradeoff, steered.reshaped)
            case {"name": "card"} if thresholds is not None and thresholds.choice is not None:
                self._saving.card(thresholds.choice)
            case {"name": "find" | "again"}:
                if steered.front is None:
                    raise MorlaxError(
                        "This checkpoint has no front. To write one: morlax evaluate RUN"
                    )
                robots = steered.twin(), steered.twin()
                self._source = PolicyComparisons(steered.front, robots, seed=self._rounds)
                self._asking = Asking(self._source)
                self._rounds += 1
            case {"name": "use" | "leave" as name}:
                if name == "use" and self._source is not None:
                    self._steer(self._source.best()[1])
                self._asking = self._source = None
        if self._asking is not None:
            self._asking.react(request)

    def _open(self, choice: library.Choice, session: Session) -> None:
        self._choice, self._lineup = choice, Lineup(session, self._put)
        self._saving = Saving(choice, self._put)
        # shipped policies keep none
        self._bookmarks = bookmarks(choice.run) if own_folder(choice.run) else None
        self._asking: Asking | None = None
        self._source: PolicyComparisons | None = None
        self._rounds = 0
        self._front: Front | None = None  # that thresholds refer to
        self._chosen: Thresholds | None = None

    def _thresholds(self) -> Thresholds | None:
        """Return the thresholds for the steered robot's front, if it has one."""
        session = self._lineup.steered
        if session.front is not self._front:
            self._front, self._chosen = session.front, None
            if session.front is not None:
                policy, lower = session.player.policy, session.player.env.lower_is_better
                self._chosen = Thresholds(policy, session.front, self._put, self._steer, lower)
        return self._chosen

    def _runs(self) -> dict[str, str]:
        """Return the labels of the runs to choose from, by name."""
        if time.monotonic() > self._scanned + SCAN:
            self._scanned, self._labels = time.monotonic(), library.labels()
        return {self._choice.run: self._choice.run, **self._labels}

    def _steer(self, tradeoff: Weights) -> None:
        self._lineup.steered.tradeoff = tradeoff
