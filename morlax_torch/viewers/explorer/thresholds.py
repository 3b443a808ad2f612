"""Choose a trade-off by what its policy must reach, while the robots go on."""

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Evaluated, Simulated, chooser
from .session import Put, Weights


class Wanted(NamedTuple):
    """Requirements by name, and the value to maximize."""

    at_least: dict[str, float]
    maximize: str
    at_most: dict[str, float]


class Thresholds:
    """Required values, and the value to maximize.

    Values are returns by objective, then measured quantities, by index. A thread of its own
    simulates, one search after the other.

    Args:
        policy: to simulate, on the CPU.
        front: evaluated trade-offs to start from.
        put: queues a request.
        steer: called with the trade-off that was found.
        lower_is_better: names of quantities; they are required to be at most, others at least.
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
        self._chooser: Evaluated | Simulated | None = None
        self._wanted: Wanted | None = None  # by the user; None: no thresholds
        self.searching = False
        self.levels: dict[int, float] = {}  # required values by index
        self.maximized = 0
        self.found: Choice | None = None
        self.reason = ""  # why nothing was found

    def state(self) -> dict[str, Any]:
        """Describe the thresholds for a page."""
        return {
            "levels": {str(index): level for index, level in self.levels.items()},
            "maximized": self.maximized,
            "searching": self.searching and self._wanted is not None,
            "found": self.found and _sent(self.found),
            "reason": self.reason,
        }

    def stop(self) -> None:
        """Require nothing, and ignore what the current search will find."""
        self.levels.clear()
        self._wanted, self.found, self.reason = None, None, ""

    def require(self, index: int, level: float | None) -> None:
        """Require a value, within the front's range, and search; None: any."""
        values = self._front.values[:, index]
        if level is None:
            self.levels.pop(index, None)
        else:
            self.levels[index] = float(min(max(level, values.min()), values.max()))
        if self.levels:
            self._choose()
        else:
            self.stop()

    def maximize(self, index: int) -> None:
        """Get as much of a value as the thresholds allow, and search if there are any."""
        self.maximized = index
        if self.levels:
            self._choose()

    def wanted(self) -> Wanted:
        """Return what is required and maximized, by name."""
        named = {self.names[index]: level for index, level in self.levels.items()}
        least = {name: level for name, level in named.items() if name not in self._lower}
        most = {name: level for name, level in named.items() if name in self._lower}
        return Wanted(least, self.names[self.maximized], most)

    def _choose(self) -> None:
        """Search for the trade-off that meets the thresholds, now or after the current search."""
        self._wanted = self.wanted()
        self.found, self.reason = None, ""
        if not self.searching:
            self.searching = True
            threading.Thread(target=self._search, args=[self._wanted], daemon=True).start()

    def _search(self, wanted: Wanted) -> None:
        """Search in another thread, and queue what follows."""
        found: Choice | Exception
        try:
            if self._chooser is None:
                self._chooser = chooser(self._policy, self._front)
            found = self._chooser.choose(*wanted)
        except Exception as error:  # raised again where it can be shown
            found = error
        self._put(lambda: self._end(wanted, found))

    def _end(self, wanted: Wanted, found: Choice | Exception) -> None:
        """Steer to the choice, or store the error; search again if the thresholds have changed."""
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


def _sent(found: Choice) -> dict[str, Any]:
    """Return a choice without quantities that JSON does not have."""
    finite = {name: value for name, value in found.quantities.items() if math.isfinite(value)}
    return found._replace(quantities=finite)._asdict()
