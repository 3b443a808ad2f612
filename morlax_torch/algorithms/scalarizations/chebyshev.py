"""Chebyshev scalarizations, which reach the concave parts of a front too."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ...gpu.group import ALONE, Group
from .interface import Scalarization

FORGETTING = 0.01  # share by which the range shrinks towards today's returns, per iteration
SMOOTHNESS = 0.05  # mu, in units of the range between nadir and ideal
AUGMENTATION = 0.05  # rho


class Ranged(Scalarization):
    """A scalarization that measures returns between a running ideal and nadir point.

    These are the best and worst expected return in each objective. A return beyond the range widens
    it at once. Otherwise both points move slowly towards today's best and worst returns, so that
    those of the first policies are forgotten.
    """

    uses_returns = True

    def __init__(self, num_objectives: int, device: torch.device):
        most = torch.finfo(torch.float32).max  # the first returns replace it
        self.ideal = torch.full((num_objectives,), -most, dtype=torch.float32, device=device)
        self.nadir = -self.ideal

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
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
        points = {"best_return": self.ideal, "worst_return": self.nadir}
        return {
            f"{kind}/{name}": value
            for kind, point in points.items()
            for name, value in zip(objectives, point, strict=True)
        }


class AugmentedChebyshev(Ranged):
    """u = -max_i w_i d_i - rho sum_i w_i d_i, with d_i the distance to the ideal point.

    (Steuer and Choo, 1983. `Ranged` defines the distance.) The gradient is that of the objective
    that lies furthest behind, and a little of all.
    """

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        return -behind.amax(-1) - AUGMENTATION * behind.sum(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        furthest = torch.zeros_like(behind).scatter_(-1, behind.argmax(-1, keepdim=True), 1.0)
        return tradeoffs / self.scale() * (furthest + AUGMENTATION)


class SmoothChebyshev(AugmentedChebyshev):
    """u = -mu log sum_i exp(w_i d_i / mu), with d_i the distance to the ideal point.

    (Lin et al., 2024, "Smooth Tchebycheff Scalarization for Multi-Objective Optimization", eq. 6,
    for maximization. `Ranged` defines the distance.) All objectives count, the more the further
    they lie behind.
    """

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        return -SMOOTHNESS * (behind / SMOOTHNESS).logsumexp(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.distances(returns)
        return (behind / SMOOTHNESS).softmax(-1) * tradeoffs / self.scale()
