"""Constraints: at least so much of one objective, for every level of it."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ...gpu.group import ALONE, Group
from .chebyshev import Ranged

LEVELS = 33  # for which multipliers are kept, evenly from the nadir to the ideal point
RATE = 0.3  # of the multipliers, per iteration
MOST = 100.0  # of a multiplier


class Constrained(Ranged):
    """Maximize the other objectives subject to r_c >= level, for all levels at once.

    The weight w_c of the constrained objective, with index c, is the required level: 0 is its worst
    return among all trade-offs, 1 its best (see `Ranged`). The other weights weigh the other
    objectives, in units of their ranges. The Lagrangian is

        u = sum_{i != c} w_i / (1 - w_c) r_i / range_i
            + lambda(w_c) ((r_c - nadir_c) / range_c - w_c)

    and gradient ascent on the policies takes turns with gradient descent on the multipliers
    lambda >= 0 (Arrow, Hurwicz and Uzawa, 1958), a piecewise linear function of the level.
    """

    def __init__(self, constrained: int, num_objectives: int, device: torch.device):
        super().__init__(num_objectives, device)
        self._c = constrained
        self.multipliers = torch.ones(LEVELS, dtype=torch.float32, device=device)
        self._others = torch.ones(num_objectives, dtype=torch.float32, device=device)
        self._others[constrained] = 0.0
        self._levels = torch.linspace(0, 1, LEVELS, dtype=torch.float32, device=device)

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        spare = self._reached(returns) - tradeoffs[:, self._c]
        others = (self._weights_of_others(tradeoffs) * returns).sum(-1)
        return others + self._multiplier(tradeoffs) * spare

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        scale = self.scale()
        own = self._multiplier(tradeoffs)[:, None] * (1 - self._others) / scale
        return self._weights_of_others(tradeoffs) + own

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        super().observe(tradeoffs, returns, group)
        missing = tradeoffs[:, self._c] - self._reached(returns)
        near = self._near(tradeoffs)  # (K, LEVELS)
        sums = group.mean_(torch.stack([(near * missing[:, None]).sum(0), near.sum(0)]))
        mean = sums[0] / sums[1].clamp(min=1e-6)
        self.multipliers.add_(RATE * mean).clamp_(0.0, MOST)

    def state(self) -> list[Tensor]:
        return [*super().state(), self.multipliers]

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        quarters = range(0, LEVELS, (LEVELS - 1) // 4)
        multipliers = {f"multiplier/{i / (LEVELS - 1):g}": self.multipliers[i] for i in quarters}
        return {**super().metrics(objectives), **multipliers}

    def _reached(self, returns: Tensor) -> Tensor:
        """Return the constrained objective's returns as levels (K,)."""
        return (1 - self.distances(returns))[:, self._c]

    def _weights_of_others(self, tradeoffs: Tensor) -> Tensor:
        own = tradeoffs * self._others
        total = own.sum(-1, keepdim=True)
        even = self._others / self._others.sum()
        return torch.where(total > 1e-6, own / total.clamp(min=1e-6), even) / self.scale()

    def _near(self, tradeoffs: Tensor) -> Tensor:
        """Return the shares (K, LEVELS) of the levels next to each required one."""
        distance = (tradeoffs[:, self._c, None] - self._levels).abs()
        return (1 - distance * (LEVELS - 1)).clamp(min=0.0)

    def _multiplier(self, tradeoffs: Tensor) -> Tensor:
        return self._near(tradeoffs) @ self.multipliers.to(tradeoffs)
