"""What a page shows: up to four robots of a run, or two of them to compare."""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from ...configuration.schedules import Schedule
from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...host.phases import heard_by
from ...networks.policy import Policy
from ...runs.checkpoint import folder_of
from ...runs.choosing import Chooser
from ...runs.loading import bookmark, bookmarks, evaluate, own_folder, rename_bookmark
from ...runs.progress import kept_fronts
from ..describing import front_map, moment_map
from . import library
from .preference import Comparison
from .session import Put, Session, Weights, policies_of

MOST = 4  # robots
TRADEOFFS = 33  # of the front of a new body: few, so that it follows soon
SCAN = 3.0  # s between searches for new runs
LOOK = 1.0  # s between looks at the files that training writes
Request = dict[str, Any]  # "act", and the fields of that act


def _aside(work: Callable[[], Any], put: Put, end: Callable[[Future], None]) -> None:
    """Do `work` in another thread, and queue `end` with its future when it is done."""
    pool = ThreadPoolExecutor(1)
    pool.submit(work).add_done_callback(lambda done: put(partial(end, done)))
    pool.shutdown(wait=False)


class Thresholds:
    """Required values, and the value to maximize; one search follows the other.

    Values are returns by objective, then measured quantities, by index. The policy of `session` is
    simulated on the CPU, from the trade-offs of `front` on; `steer` is called with the trade-off
    that was found. Quantities of which less is better are required to be at most, others at least.
    """

    def __init__(self, session: Session, front: Front, put: Put, steer: Callable[[Weights], None]):
        self._front, self._put, self._steer = front, put, steer
        self._lower = session.env.lower_is_better
        self._chooser = cache(partial(Chooser, session.policy, front))  # takes a while
        self.names = *front.objectives, *front.quantity_names
        self.searching = False
        self.current: object = None  # the search that goes on; another one ends without a result
        self._rounds = 0  # of its simulations
        self.progress: dict[str, float] = {}  # of the search
        self.levels: dict[int, float] = {}  # required values by index
        self.maximized = 0  # index of a value
        self.choice: Choice | None = None
        self.reason = ""  # why there is no choice

    def state(self) -> dict[str, Any]:
        """Describe the thresholds for a page."""
        choice = None
        if self.choice is not None:
            quantities = self.choice.quantities.items()
            finite = {name: value for name, value in quantities if math.isfinite(value)}
            choice = {**self.choice._asdict(), "quantities": finite, "required": None}
        return {
            "levels": {str(index): level for index, level in self.levels.items()},
            "maximized": self.maximized,
            "searching": self.searching and bool(self.levels),
            "progress": self.progress,
            "found": choice,
            "reason": self.reason,
        }

    def stop(self) -> None:
        """Require nothing, and ignore what the current search will find."""
        self.levels.clear()
        self.search()

    def require(self, index: int, level: float | None) -> None:
        """Require a value, within the front's range, and search; None: any."""
        values = self._front.values[:, index]
        if level is None:
            self.levels.pop(index, None)
        else:
            self.levels[index] = float(min(max(level, values.min()), values.max()))
        free = (i for i, name in enumerate(self.names) if name not in self._lower)
        if self.maximized in self.levels:
            self.maximized = next((i for i in free if i not in self.levels), self.maximized)
        self.search()

    def search(self) -> None:
        """Search for the trade-off that meets the thresholds, now or after the current search."""
        self.choice, self.reason, self.progress = None, "", {}
        search = self.current = object()
        if self.levels and not self.searching:
            self.searching, self._rounds = True, 0
            named = {self.names[index]: level for index, level in self.levels.items()}
            least = {name: level for name, level in named.items() if name not in self._lower}
            most = {name: level for name, level in named.items() if name in self._lower}
            maximized = self.names[self.maximized]

            def work() -> Choice:
                with heard_by(partial(self._hear, search)):
                    return self._chooser().choose(least, maximized, most)

            _aside(work, self._put, partial(self._end, search))

    def _hear(self, search: object, doing: str, share: float | None) -> None:
        """Note what a search does; end one that nobody waits for. Called in its thread."""
        if search is not self.current:
            raise MorlaxError("the search was canceled.")
        share = share or 0.0
        if share < self.progress.get("share", 1.0):  # another round of simulations
            self._rounds += 1
        self.progress = {"round": self._rounds, "share": share}

    def _end(self, search: object, done: Future[Choice]) -> None:
        """Steer to the choice, or store the error; search again if the thresholds have changed."""
        self.searching = False
        if self.current not in (search, None):
            return self.search()
        try:
            self.choice = done.result()
            self._steer(self.choice.tradeoff)
        except MorlaxError as error:
            self.reason = str(error)


Written = tuple[library.Choice, Policy, Front | None, list[dict[str, Any]]]


def _read(choice: library.Choice) -> Written:
    kept = kept_fronts(folder_of(choice.file))
    moments = [moment_map(file, *numbers) for file, numbers in kept.items()]
    return library.choose(choice.run, choice.checkpoint), *policies_of(choice), moments


class RunExhibit:
    """Robots of a run, all with one body, of which users steer one; or two of "A or B?".

    While the run is being trained, the policies of its newest checkpoint replace those shown.

    `robots` are at least one, `state` describes as JSON what can change apart from poses, and
    `react` fulfills a request, or raises MorlaxError. `put` queues calls of other threads that use
    the robots.
    """

    def __init__(
        self, choice: library.Choice, put: Put, tradeoff: Weights | Schedule | None = None
    ):
        self._put, self._scanned, self._looked = put, -SCAN, -LOOK
        self._labels: dict[str, str] = {}  # of runs to choose from
        self._measuring = self._reading = False
        self._open(choice, Session(*policies_of(choice)))
        if isinstance(tradeoff, Schedule):
            self._steered.schedule, self._steered.follows = tradeoff, True
        elif tradeoff:
            self._steer(tradeoff)

    def _open(self, choice: library.Choice, session: Session) -> None:
        # shipped policies keep none; the page stays as it is where they are damaged
        self._bookmarks = bookmarks(choice.run) if own_folder(choice.run) else None
        self._choice, self._sessions, self._selected = choice, [session], 0
        self._stale = False  # whether the page shows the front of a former body
        self._saving = {"busy": False, "text": ""}
        self._asking: Comparison | None = None
        self._rounds = self._episodes = 0
        self._front: Front | None = None  # that thresholds refer to
        self._chosen: Thresholds | None = None
        self._written: list[int] | None = None  # when the files that were read were written
        self._training: list[dict[str, Any]] = []  # moments of it
        self._map: dict[str, Any] | None = None  # of the latest front

    @property
    def robots(self) -> Sequence[Session]:
        return self._asking.robots if self._asking else self._sessions

    @property
    def _steered(self) -> Session:
        return self._sessions[self._selected]

    def state(self) -> dict[str, Any]:
        self._follow()
        thresholds = self._thresholds()
        return {
            "front": self._map,
            "training": self._training,
            "asking": self._asking and self._asking.state(),
            "runs": self._runs(),
            "run": self._choice.run,
            "checkpoint": self._choice.checkpoint,
            "checkpoints": list(self._choice.files),
            "selected": self._selected,
            "command": list(self._steered.command),
            "design": self._steered.design,
            "measured": not self._stale,
            "choosing": thresholds and thresholds.state(),
            "bookmarks": self._bookmarks,
            "saving": self._saving,
        }

    def react(self, request: Request) -> None:
        steered, thresholds = self._steered, self._thresholds()
        command = steered.command
        sessions = {*self._sessions, *self.robots}
        match request:
            case {"act": "steer", "weights": weights} if len(weights) == len(steered.objectives):
                if min(weights) >= 0 and 0 < sum(weights) < float("inf"):
                    self._steer(weights)
            case {"act": "tell", "index": i, "value": value} if i < len(command):
                for session in sessions:
                    session.tell(i, value)
            case {"act": "nudge", "index": i, "change": change} if i < len(command):
                for session in sessions:
                    session.tell(i, session.command[i] + change)
            case {"act": "reshape", "index": i, "value": value} if i < len(steered.design):
                self._reshape(i, value)
            case {"act": "select", "robot": robot} if robot < len(self._sessions):
                self._selected = robot
            case {"act": "open", "run": run, "checkpoint": checkpoint} if run in self._runs():
                choice = library.choose(run, checkpoint)
                session = Session(*policies_of(choice))
                if session.objectives == steered.objectives:
                    session.tradeoff, session.schedule = steered.tradeoff, steered.schedule
                    session.follows = steered.follows
                if session.env.command_limits == steered.env.command_limits:
                    session.command = list(command)
                if thresholds is not None:
                    thresholds.stop()
                self._open(choice, session)
            case {"act": "require", "index": i} if thresholds and i < len(thresholds.names):
                thresholds.require(i, request["level"])
            case {"act": "maximize", "index": i} if thresholds and i < len(thresholds.names):
                thresholds.maximized = i
                thresholds.search()
            case {"act": "bookmark", "name": name}:
                bookmark(self._choice.run, name, steered.tradeoff, replaces=False)
                self._bookmarks = bookmarks(self._choice.run)
            case {"act": "rename", "name": name, "new": new} if name in (self._bookmarks or ()):
                rename_bookmark(self._choice.run, name, new)
                self._bookmarks = bookmarks(self._choice.run)
            case {"name": "reset"}:
                self._restart()
            case {"name": "push"}:
                for session in sessions:
                    session.push()
            case {"name": "add"}:
                self._add()
            case {"name": "remove"} if len(self._sessions) > 1:
                del self._sessions[self._selected]
                self._selected = min(self._selected, len(self._sessions) - 1)
            case {"name": "follow"}:
                steered.follows = True
            case {"name": "free"} if thresholds is not None:
                thresholds.stop()
            case {"name": "cancel"} if thresholds is not None:
                thresholds.current = None
            case {"name": "measure"} if self._stale:
                self._measure()
            case {"name": "export"}:
                work = partial(self._choice.export, steered.tradeoff, steered.reshaped)
                self._save("Exporting the policy…", work)
            case {"name": "card"} if thresholds is not None and thresholds.choice is not None:
                policies = steered.policy, thresholds.choice, steered.reshaped
                work = partial(self._choice.write_card, *policies)
                self._save("Trying the policy under other conditions…", work)
            case {"name": "find" | "again"}:
                if steered.front is None:
                    coming = "that of this body comes soon"
                    way = coming if self._stale else "morlax evaluate RUN writes one"
                    raise MorlaxError(f"there is no front yet: {way}.")
                robots = steered.twin(), steered.twin()
                self._asking = Comparison(steered.front, robots, seed=self._rounds)
                self._rounds += 1
            case {"act": "answer", "preferred": preferred} if self._asking is not None:
                self._asking.answer(preferred)
            case {"name": "skip"} if self._asking is not None:
                self._asking.skip()
            case {"name": "use" | "leave" as name}:
                if name == "use" and self._asking is not None:
                    self._steer(self._asking.best_tradeoff)
                self._asking = None

    def _steer(self, weights: Sequence[float]) -> None:
        self._steered.follows = False
        self._steered.tradeoff = tuple(weight / sum(weights) for weight in weights)

    def _add(self) -> None:
        """Add a robot with the selected one's trade-off and select it; all start anew."""
        if len(self._sessions) == MOST:
            raise MorlaxError(f"the page shows at most {MOST} robots: remove one first.")
        self._sessions.append(self._steered.twin())
        self._selected = len(self._sessions) - 1
        self._restart()

    def _restart(self) -> None:
        """Start an episode of all robots, which begin and are disturbed alike."""
        self._episodes += 1
        for session in self.robots:
            session.reset(self._episodes)

    def _reshape(self, index: int, value: float) -> None:
        """Set one design parameter of all robots; it is clamped to its range."""
        self._asking = None
        if self._chosen is not None:
            self._chosen.stop()
        policy, design = self._steered.policy, self._steered.design
        parameters = policy.agent.designs
        _, low, high, _ = list(parameters.values())[index]
        design[index] = min(max(value, low), high)
        policy = policy.for_design(dict(zip(parameters, design, strict=True)))
        for session in self._sessions:
            session.reshape(policy)
        self._stale = True

    def _measure(self) -> None:
        """Evaluate the front of the robots' body, one body after the other."""
        if not self._measuring:
            self._measuring, policy = True, self._steered.policy
            work = partial(evaluate, policy, TRADEOFFS, device="cpu")
            _aside(work, self._put, partial(self._measured, policy))

    def _measured(self, policy: Policy, done: Future[Front]) -> None:
        """Show the front of a body, or go on with another one that the robots have by now."""
        self._measuring = False
        front = done.result()._replace(checkpoint="this body")
        if self._steered.policy is policy:
            self._stale = False
            for session in self._sessions:
                session.front = front
        elif self._stale:
            self._measure()

    def _save(self, doing: str, work: Callable[[], list[Path]]) -> None:
        """Write files while the robots go on, unless others are being written."""
        if not self._saving["busy"]:
            self._saving = {"busy": True, "text": doing}
            _aside(work, self._put, self._saved)

    def _saved(self, done: Future[list[Path]]) -> None:
        self._saving = {"busy": False, "text": str(done.exception())}
        self._saving["text"] = "written: " + ", ".join(map(str, done.result()))

    def _follow(self) -> None:
        """Read what training has written, in another thread, unless it is known."""
        if self._reading or time.monotonic() < self._looked + LOOK:
            return
        self._looked, written = time.monotonic(), self._choice.written()
        if written != self._written and not self._judges():
            self._reading, work = True, partial(_read, self._choice)
            _aside(work, self._put, partial(self._renew, self._choice, written))

    def _judges(self) -> bool:
        """Return whether a user judges policies, which therefore stay as they are."""
        levels = self._chosen and self._chosen.levels
        return bool(self._asking or levels or self._steered.reshaped)

    def _renew(self, choice: library.Choice, written: list[int], done: Future[Written]) -> None:
        """Show what training has written, if the page still shows that checkpoint."""
        self._reading = False
        if choice is not self._choice or self._judges():
            return
        with suppress(MorlaxError):  # training has removed a file meanwhile: read again
            self._choice, policy, front, self._training = done.result()
            self._written = written
            if front and (not self._front or front.fingerprint != self._front.fingerprint):
                for session in self._sessions:
                    session.renew(policy, front)

    def _thresholds(self) -> Thresholds | None:
        """Return the thresholds for the steered robot's front, if it has one."""
        session = self._steered
        if session.front is not self._front:
            self._front, self._chosen = session.front, None
            if session.front is not None:
                self._chosen = Thresholds(session, session.front, self._put, self._steer)
                self._map = front_map(session.front, session.env)
        return self._chosen

    def _runs(self) -> dict[str, str]:
        """Return the labels of the runs to choose from, by name."""
        if time.monotonic() > self._scanned + SCAN:
            self._scanned, self._labels = time.monotonic(), library.labels()
        return {self._choice.run: self._choice.run, **self._labels}
