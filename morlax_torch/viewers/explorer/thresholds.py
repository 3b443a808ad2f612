"""Choose a trade-off by what its policy must reach, while the robots go on."""

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Chooser
from .session import Put, Weights

Wanted = tuple[dict[str, float], str, dict[str, float]]  # arguments of `Chooser.choose`


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
        self._chooser: Chooser | None = None
        self.searching = False
        self.levels: dict[int, float] = {}  # required values by index
        self.maximized = 0
        self.choice: Choice | None = None
        self.reason = ""  # why there is no choice

    def state(self) -> dict[str, Any]:
        """Describe the thresholds for a page."""
        return {
            "levels": {str(index): level for index, level in self.levels.items()},
            "maximized": self.maximized,
            "searching": self.searching and bool(self.levels),
            "found": self.choice and _sent(self.choice),
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
            self.searching = True
            threading.Thread(target=self._choose, args=[self._wanted()], daemon=True).start()

    def _choose(self, wanted: Wanted) -> None:
        """Choose in another thread, and queue what follows."""
        try:
            if self._chooser is None:
                self._chooser = Chooser(self._policy, self._front)
            result = self._chooser.choose(*wanted)
        except Exception as error:  # raised again where it can be shown
            result = error
        self._put(lambda: self._end(wanted, result))

    def _end(self, wanted: Wanted, result: Choice | Exception) -> None:
        """Steer to the choice, or store the error; search again if the thresholds have changed."""
        self.searching = False
        if wanted != self._wanted():
            self._search()
        elif isinstance(result, Choice):
            self.choice = result
            self._steer(result.tradeoff)
        elif isinstance(result, MorlaxError):
            self.reason = str(result)
        else:
            raise result


def _sent(choice: Choice) -> dict[str, Any]:
    """Return a choice as JSON, without quantities that JSON does not have."""
    sent = choice._asdict()
    del sent["required"]
    finite = {name: value for name, value in choice.quantities.items() if math.isfinite(value)}
    return sent | {"quantities": finite}
