"""The range of returns that today's policies reach."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ..gpu.group import Group

FORGETTING = 0.01  # share by which the range shrinks towards today's returns, per iteration


class Range:
    """A running ideal and nadir point: the best and worst expected return in each objective.

    A return beyond the range widens it at once. Otherwise both points move slowly towards today's
    best and worst returns, so that those of the first policies are forgotten.

    Args:
        num_objectives: m.
        device: of the points.
    """

    def __init__(self, num_objectives: int, device: torch.device):
        most = torch.finfo(torch.float32).max  # the first returns replace it
        self.ideal = torch.full((num_objectives,), -most, device=device)
        self.nadir = torch.full((num_objectives,), most, device=device)

    def observe(self, returns: Tensor, group: Group) -> None:
        """Take note of the expected returns (K, m) of all trade-offs."""
        best = group.largest_(torch.cat([returns.amax(0), -returns.amin(0)]))
        high, low = best[: len(self.ideal)], -best[len(self.ideal) :]
        slow_high = self.ideal + FORGETTING * (high - self.ideal)
        slow_low = self.nadir + FORGETTING * (low - self.nadir)
        seen = self.nadir <= self.ideal
        self.ideal.copy_(torch.where(seen, torch.maximum(slow_high, high), high))
        self.nadir.copy_(torch.where(seen, torch.minimum(slow_low, low), low))

    def scale(self) -> Tensor:
        """Return the width of the range (m,), above zero."""
        width = self.ideal - self.nadir
        return width.clamp(min=1e-6 * self.ideal.abs().clamp(min=1.0))

    def distances(self, returns: Tensor) -> Tensor:
        """Return how far returns (K, m) lie below the ideal point, in units of the range."""
        return (self.ideal - returns) / self.scale()

    def state(self) -> list[Tensor]:
        return [self.ideal, self.nadir]

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        """Return both points () each, by name."""
        points = {"best_return": self.ideal, "worst_return": self.nadir}
        return {
            f"{kind}/{name}": value
            for kind, point in points.items()
            for name, value in zip(objectives, point, strict=True)
        }
