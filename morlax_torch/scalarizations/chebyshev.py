"""Chebyshev scalarizations, which reach the concave parts of a front too."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ..gpu.group import ALONE, Group
from .range import Range

SMOOTHNESS = 0.05  # mu, in units of the range between nadir and ideal
AUGMENTATION = 0.05  # rho


class AugmentedChebyshev:
    """u = -max_i w_i d_i - rho sum_i w_i d_i, with d_i the distance to the ideal point.

    (Steuer and Choo, 1983. `Range` defines the distance.) The gradient is that of the objective
    that lies furthest behind, and a little of all.
    """

    uses_returns = True

    def __init__(self, num_objectives: int, device: torch.device):
        self.range = Range(num_objectives, device)

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.range.distances(returns)
        return -behind.amax(-1) - AUGMENTATION * behind.sum(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.range.distances(returns)
        furthest = torch.zeros_like(behind).scatter_(-1, behind.argmax(-1, keepdim=True), 1.0)
        return tradeoffs / self.range.scale() * (furthest + AUGMENTATION)

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        self.range.observe(returns, group)

    def state(self) -> list[Tensor]:
        return self.range.state()

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        return self.range.metrics(objectives)


class SmoothChebyshev(AugmentedChebyshev):
    """u = -mu log sum_i exp(w_i d_i / mu), with d_i the distance to the ideal point.

    (Lin et al., 2024, "Smooth Tchebycheff Scalarization for Multi-Objective Optimization", eq. 6,
    for maximization. `Range` defines the distance.) All objectives count, the more the further
    they lie behind.
    """

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.range.distances(returns)
        return -SMOOTHNESS * (behind / SMOOTHNESS).logsumexp(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        behind = tradeoffs * self.range.distances(returns)
        return (behind / SMOOTHNESS).softmax(-1) * tradeoffs / self.range.scale()
