"""What actors observe of a task of mjlab: which terms, and how many of their last values."""

from collections.abc import Iterable, Mapping
from fnmatch import filter as matching

import torch
from torch import Tensor

from ...errors import MorlaxError, unknown

# terms that no sensor of a robot gives: velocity and position in the world, a scan of the ground
UNMEASURED = ("base_lin_vel", "motion_anchor_pos_b", "height_scan")


def lengths(terms: Iterable[str], sensors: str, history: Mapping[str, int]) -> dict[str, int]:
    """Return how many values of each of mjlab's terms actors observe; 0: none."""
    numbers = dict.fromkeys(terms, 1)
    for pattern, number in history.items():
        names = matching(numbers, pattern)
        if not names:
            raise unknown("term of the observation", pattern, numbers)
        numbers |= dict.fromkeys(names, number)
    if sensors == "real":
        numbers |= dict.fromkeys((name for name in UNMEASURED if name in numbers), 0)
    if not any(numbers.values()):
        raise MorlaxError(
            "actors would observe nothing: leave a term of the observation in task.history."
        )
    return numbers


class History:
    """The last values of terms in N worlds, term by term, from oldest to newest.

    `sizes` are those of each term's value, `numbers` how many values to keep. mjlab's own buffers
    move on the CPU, which a recorded step cannot do.
    """

    def __init__(self, sizes: list[int], numbers: list[int], worlds: int, device: torch.device):
        most, total = max(numbers), sum(sizes)
        self._frames = torch.zeros(worlds, most, total, dtype=torch.float32, device=device)
        columns = torch.arange(most * total).view(most, total).split(sizes, 1)
        terms = zip(columns, numbers, strict=True)
        parts = [term[most - number :].flatten() for term, number in terms]
        self._columns = torch.cat(parts).to(device)
        self.size = len(self._columns)

    def after(self, values: Tensor) -> Tensor:
        """Return what would be observed after new values (N, total); keeps nothing."""
        return self._observed(self._moved(values))

    def append(self, values: Tensor, restarted: Tensor) -> Tensor:
        """Keep new values (N, total), alone where `restarted` (N,); returns what is observed."""
        return self._kept(restarted, values, self._moved(values))

    def restart(self, which: Tensor, values: Tensor) -> Tensor:
        """Keep `values` alone where `which` (N,); returns what is observed, (N, size)."""
        return self._kept(which, values, self._frames)

    def _kept(self, which: Tensor, values: Tensor, others: Tensor) -> Tensor:
        frames = torch.where(which[:, None, None], values[:, None], others)
        return self._observed(self._frames.copy_(frames))

    def _moved(self, values: Tensor) -> Tensor:
        return torch.cat([self._frames[:, 1:], values[:, None]], 1)

    def _observed(self, frames: Tensor) -> Tensor:
        return frames.flatten(1).index_select(1, self._columns)
