"""Up to four robots of one run, and long work for them in other threads while they go on."""

import math
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Chooser
from ...runs.evaluating import evaluate
from .session import Put, Session, Weights

MOST = 4  # robots
TRADEOFFS = 33  # of the front of a new body: few, so that it follows soon
Wanted = tuple[dict[str, float], str, dict[str, float]]  # arguments of `Chooser.choose`


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
    """The robots of a run, of which users steer one; all have the same body.

    `stale` is whether the page shows the front of a former body.
    """

    def __init__(self, session: Session, put: Put):
        self.sessions, self.selected = [session], 0
        self.stale = False
        self._put, self._measuring, self._waiting = put, False, False

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
            self._waiting = True
            return
        self._measuring, policy = True, self.steered.player.policy
        work = partial(evaluate, policy, TRADEOFFS, device="cpu")
        _aside(work, self._put, partial(self._end, policy))

    def _end(self, policy: Policy, front: Front | Exception) -> None:
        """Show the front of a body, unless the robots have another body by now."""
        self._measuring, waiting, self._waiting = False, self._waiting, False
        if isinstance(front, Front) and self.steered.player.policy is policy:
            self.stale = False
            for session in self.sessions:
                session.measured(front._replace(checkpoint="this body"))
        if waiting and self.stale:
            self.measure()
        if isinstance(front, Exception):
            raise front


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
        self._policy, self._front, self._put, self._steer = policy, front, put, steer
        self._lower = lower_is_better
        self.names = *front.objectives, *front.quantity_names
        self._chooser: Chooser | None = None
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
            _aside(partial(self._choose, wanted), self._put, partial(self._end, wanted))

    def _choose(self, wanted: Wanted) -> Choice:
        if self._chooser is None:
            self._chooser = Chooser(self._policy, self._front)
        return self._chooser.choose(*wanted)

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
