"""The exhibits of a page: up to four robots of a run, or two behaviors to compare."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, Protocol

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Chooser
from ...runs.evaluating import evaluate
from ...runs.loading import bookmark, bookmarks, own_folder
from . import library
from .comparisons import Comparisons, PolicyComparisons
from .saving import Saving
from .session import Behavior, Put, Session, Weights

MOST = 4  # robots
TRADEOFFS = 33  # of the front of a new body: few, so that it follows soon
Wanted = tuple[dict[str, float], str, dict[str, float]]  # arguments of `Chooser.choose`
SCAN = 3.0  # s between searches for new runs
Request = dict[str, Any]  # "act", and the fields of that act


def _aside(work: Callable[[], Any], put: Put, end: Callable[[Any], None]) -> None:
    """Do `work` in another thread, and queue `end` with its result, or the error as such."""

    def run() -> None:
        try:
            result = work()
        except Exception as error:
            result = error
        put(partial(end, result))

    threading.Thread(target=run, daemon=True).start()


class Lineup:
    """The robots of a run, of which users steer one; all have the same body."""

    def __init__(self, session: Session, put: Put):
        self.sessions, self.selected = [session], 0
        self.stale = False  # whether the page shows the front of a former body
        self._put, self._measuring = put, False

    @property
    def steered(self) -> Session:
        return self.sessions[self.selected]

    def add(self) -> None:
        """Add a robot with the selected one's trade-off and select it; all start anew."""
        if len(self.sessions) == MOST:
            raise MorlaxError(f"the page shows at most {MOST} robots: remove one first.")
        self.sessions.append(self.steered.twin())
        self.selected = len(self.sessions) - 1
        for session in self.sessions:
            session.reset()

    def remove(self) -> None:
        """Remove the selected robot, unless it is the only one."""
        if len(self.sessions) > 1:
            del self.sessions[self.selected]
            self.selected = min(self.selected, len(self.sessions) - 1)

    def reshape(self, index: int, value: float) -> None:
        """Set one design parameter of all robots; it is clamped to its range."""
        policy, design = self.steered.player.policy, self.steered.design
        parameters = policy.agent.designs
        _, low, high, _ = list(parameters.values())[index]
        design[index] = min(max(value, low), high)
        policy = policy.for_design(dict(zip(parameters, design, strict=True)))
        for session in self.sessions:
            session.reshape(policy)
        self.stale = True

    def measure(self) -> None:
        """Evaluate the front of the robots' body, one body after the other."""
        if self._measuring:
            return
        self._measuring, policy = True, self.steered.player.policy
        work = partial(evaluate, policy, TRADEOFFS, device="cpu")
        _aside(work, self._put, partial(self._end, policy))

    def _end(self, policy: Policy, front: Front | Exception) -> None:
        """Show the front of a body, or go on with another one that the robots have by now."""
        self._measuring = False
        if isinstance(front, Exception):
            raise front
        if self.steered.player.policy is not policy:
            self.measure()
        else:
            self.stale = False
            for session in self.sessions:
                session.front, session.robot = front._replace(checkpoint="this body"), policy


class Thresholds:
    """Required values, and the value to maximize; one search follows the other.

    Values are returns by objective, then measured quantities, by index. `policy` is simulated on
    the CPU, from the trade-offs of `front` on; `steer` is called with the trade-off that was found.
    Quantities in `lower_is_better` are required to be at most, others at least.
    """

    def __init__(
        self,
        policy: Policy,
        front: Front,
        put: Put,
        steer: Callable[[Weights], None],
        lower_is_better: Sequence[str] = (),
    ):
        self._front, self._put, self._steer, self._lower = front, put, steer, lower_is_better
        self._chooser = cache(lambda: Chooser(policy, front))  # takes a while
        self.names = *front.objectives, *front.quantity_names
        self.searching = False
        self.levels: dict[int, float] = {}  # required values by index
        self.maximized = 0
        self.choice: Choice | None = None
        self.reason = ""  # why there is no choice

    def state(self) -> dict[str, Any]:
        """Describe the thresholds for a page."""
        choice = None
        if self.choice is not None:
            quantities = self.choice.quantities.items()
            finite = {name: value for name, value in quantities if math.isfinite(value)}
            choice = {**self.choice._asdict(), "quantities": finite}
            del choice["required"]
        return {
            "levels": {str(index): level for index, level in self.levels.items()},
            "maximized": self.maximized,
            "searching": self.searching and bool(self.levels),
            "found": choice,
            "reason": self.reason,
        }

    def stop(self) -> None:
        """Require nothing, and ignore what the current search will find."""
        self.levels.clear()
        self._search()

    def require(self, index: int, level: float | None) -> None:
        """Require a value, within the front's range, and search; None: any."""
        values = self._front.values[:, index]
        if level is None:
            self.levels.pop(index, None)
        else:
            self.levels[index] = float(min(max(level, values.min()), values.max()))
        self._search()

    def maximize(self, index: int) -> None:
        """Get as much of a value as the thresholds allow, and search if there are any."""
        self.maximized = index
        self._search()

    def _wanted(self) -> Wanted:
        """Return what is required and maximized, by name."""
        named = {self.names[index]: level for index, level in self.levels.items()}
        least = {name: level for name, level in named.items() if name not in self._lower}
        most = {name: level for name, level in named.items() if name in self._lower}
        return least, self.names[self.maximized], most

    def _search(self) -> None:
        """Search for the trade-off that meets the thresholds, now or after the current search."""
        self.choice, self.reason = None, ""
        if self.levels and not self.searching:
            self.searching, wanted = True, self._wanted()
            end = partial(self._end, wanted)
            _aside(lambda: self._chooser().choose(*wanted), self._put, end)

    def _end(self, wanted: Wanted, result: Choice | Exception) -> None:
        """Steer to the choice, or store the error; search again if the thresholds have changed."""
        self.searching = False
        if wanted != self._wanted():
            self._search()
        elif isinstance(result, MorlaxError):
            self.reason = str(result)
        elif isinstance(result, Exception):
            raise result
        else:
            self.choice = result
            self._steer(result.tradeoff)


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
    """Asks "A or B?" until a source of at least one question has no more.

    `behaviors` are A and B, which may be others after each answer; the last ones stay.
    """

    def __init__(self, source: Comparisons):
        self._source, self._question, self._answers = source, source.ask(), 0
        self._told: dict[str, Any] | None = None  # the answer before
        self.behaviors = self._question.behaviors if self._question else ()

    def state(self) -> dict[str, Any]:
        asking = {"answers": self._answers, "over": self._question is None, "told": self._told}
        return {"asking": asking | getattr(self._source, "evidence", {})}

    def react(self, request: Request) -> None:
        match request:
            case {"act": "press", "name": "reset"}:
                for behavior in self.behaviors:
                    behavior.reset()
                return
            case {"act": "answer", "preferred": preferred} if self._question is not None:
                self._told = {"preferred": preferred, "policies": self._question.policies}
                self._source.answer(preferred)
                self._answers += 1
            case {"act": "press", "name": "skip"} if self._question is not None:
                self._told = None
            case _:
                return
        self._question = self._source.ask()
        self.behaviors = self._question.behaviors if self._question else self.behaviors


class RunExhibit:
    """A run's robots, or two of "A or B?"; `put` queues calls of other threads that use them."""

    def __init__(self, choice: library.Choice, put: Put):
        self._put, self._scanned = put, -SCAN
        self._labels: dict[str, str] = {}  # of runs to choose from
        self._open(choice, Session.open(choice))

    @property
    def behaviors(self) -> Sequence[Behavior]:
        return self._asking.behaviors if self._asking else self._lineup.sessions

    def state(self) -> dict[str, Any]:
        steered, thresholds = self._lineup.steered, self._thresholds()
        return {
            "asking": None,
            "runs": self._runs(),
            "run": self._choice.run,
            "checkpoint": self._choice.checkpoint,
            "checkpoints": list(self._choice.files),
            "selected": self._lineup.selected,
            "command": list(steered.player.command),
            "design": steered.design,
            "measured": not self._lineup.stale,
            "choosing": thresholds and thresholds.state(),
            "bookmarks": self._bookmarks,
            "saving": self._saving.state(),
            **(self._asking.state() if self._asking else {}),
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
                self._asking = None
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
            case {"name": "reset"} if self._asking is None:
                for session in sessions:
                    session.reset()
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
                    raise MorlaxError("There is no front: morlax evaluate RUN writes one.")
                robots = steered.twin(), steered.twin()
                self._source = PolicyComparisons(steered.front, robots, seed=self._rounds)
                self._asking = ComparisonExhibit(self._source)
                self._rounds += 1
            case {"name": "use" | "leave" as name}:
                if name == "use" and self._asking is not None:
                    self._steer(self._source.best()[1])
                self._asking = None
        if self._asking is not None:
            self._asking.react(request)

    def _open(self, choice: library.Choice, session: Session) -> None:
        self._choice, self._lineup = choice, Lineup(session, self._put)
        self._saving = Saving(choice, self._put)
        # shipped policies keep none
        self._bookmarks = bookmarks(choice.run) if own_folder(choice.run) else None
        self._asking: ComparisonExhibit | None = None
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
