"""Critics of off-policy learning, which value a state and an action twice."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from .mlp import mlp


class Twins(nn.Module):
    """Two critics Q(s, a) of m objectives that share nothing.

    The smaller of two estimates counters overestimation (Fujimoto et al., 2018), and normalized
    layers keep values bounded where no data is (Ball et al., 2023).

    Args:
        inputs: features of an observation, and actions.
        hidden: hidden layers of each.
        num_objectives: m.
        generator: draws the initial parameters.
    """

    def __init__(
        self,
        inputs: int,
        hidden: Sequence[int],
        num_objectives: int,
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        self.networks = nn.ModuleList(
            _normalized(mlp(inputs, hidden, num_objectives, generator)) for _ in range(2)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map observations beside actions (..., inputs) to values (..., 2m), first by twin."""
        return torch.cat([network(x) for network in self.networks], -1)


def smaller(values: Tensor, weights: Tensor) -> Tensor:
    """Return the values (..., m) of the twin whose weighted sum is the smaller one.

    Args:
        values: of the twins (..., 2m), first by twin.
        weights: (..., m)
    """
    one, other = values.chunk(2, -1)
    less = (one * weights).sum(-1, True) < (other * weights).sum(-1, True)
    return torch.where(less, one, other)


def _normalized(network: nn.Sequential) -> nn.Sequential:
    """Return the network with a normalization before each activation."""
    layers: list[nn.Module] = []
    for layer in network:
        layers.append(layer)
        if isinstance(layer, nn.Linear) and layer is not network[-1]:
            layers.append(nn.LayerNorm(layer.out_features, dtype=torch.float32))
    return nn.Sequential(*layers)
