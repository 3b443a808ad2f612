"""Choose a trade-off by what its policy must reach, while the robots go on."""

import threading
from collections.abc import Callable
from typing import Any

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Chooser
from .requests import Put
from .session import Weights

Wanted = tuple[dict[str, float], str]  # required returns, and the objective to maximize


class Thresholds:
    """Required returns, and the objective to maximize.

    A thread of its own simulates, one search after the other.

    Args:
        policy: to simulate, on the CPU.
        front: evaluated trade-offs to start from.
        put: queues a request.
        steer: called with the trade-off that was found.
    """

    def __init__(self, policy: Policy, front: Front, put: Put, steer: Callable[[Weights], None]):
        self._policy, self._front, self._put, self._steer = policy, front, put, steer
        self._chooser: Chooser | None = None
        self._wanted: Wanted | None = None  # by the user; None: no thresholds
        self.searching = False
        self.levels: dict[int, float] = {}  # required returns by index of the objective
        self.maximized = 0
        self.found: Choice | None = None
        self.reason = ""  # why nothing was found

    def state(self) -> dict[str, Any]:
        """Describe the thresholds for a page."""
        return {
            "levels": {str(index): least for index, least in self.levels.items()},
            "maximized": self.maximized,
            "searching": self.searching and self._wanted is not None,
            "found": self.found and self.found._asdict(),
            "reason": self.reason,
        }

    def stop(self) -> None:
        """Require nothing, and ignore what the current search will find."""
        self.levels.clear()
        self._wanted, self.found, self.reason = None, None, ""

    def require(self, index: int, least: float | None) -> None:
        """Require a return of an objective, within the front's range, and search; None: any."""
        returns = self._front.returns[:, index]
        if least is None:
            self.levels.pop(index, None)
        else:
            self.levels[index] = float(min(max(least, returns.min()), returns.max()))
        if self.levels:
            self._choose()
        else:
            self.stop()

    def maximize(self, index: int) -> None:
        """Get as much of an objective as the thresholds allow, and search if there are any."""
        self.maximized = index
        if self.levels:
            self._choose()

    def _choose(self) -> None:
        """Search for the trade-off that meets the thresholds, now or after the current search."""
        names = self._front.objectives
        required = {names[index]: least for index, least in self.levels.items()}
        self._wanted = required, names[self.maximized]
        self.found, self.reason = None, ""
        if not self.searching:
            self.searching = True
            threading.Thread(target=self._search, args=self._wanted, daemon=True).start()

    def _search(self, required: dict[str, float], maximize: str) -> None:
        """Search in another thread, and queue what follows."""
        found: Choice | Exception
        try:
            if self._chooser is None:
                self._chooser = Chooser(self._policy, self._front)
            found = self._chooser.choose(required, maximize)
        except Exception as error:  # raised again where it can be shown
            found = error
        self._put(lambda: self._end((required, maximize), found))

    def _end(self, wanted: Wanted, found: Choice | Exception) -> None:
        """Steer to the choice, or keep why there is none; search again if thresholds changed."""
        self.searching = False
        if self._wanted is None:
            return
        if self._wanted != wanted:
            self._choose()
        elif isinstance(found, Choice):
            self.found = found
            self._steer(found.tradeoff)
        elif isinstance(found, MorlaxError):
            self.reason = str(found)
        else:
            raise found
