"""A network that takes the trade-off as an input."""

import copy

import torch
from torch import Tensor, nn

from ..gpu import fused
from .family import on_simplex
from .mlp import mlp_sizes


class Conditioned(nn.Module):
    """One network for every trade-off w, which it takes beside its input x: g(x, w).

    (AMOR: Alegre et al., 2025. A hypernetwork instead generates the network's parameters.)

    Args:
        network: maps rows (B, inputs + m) to (B, outputs); its last m inputs are the trade-off. It
            is copied, not changed.
    """

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = copy.deepcopy(network)
        self.shapes = {name: value.shape for name, value in network.named_parameters()}
        self._mlp = mlp_sizes(network)

    def forward(self, tradeoffs: Tensor) -> dict[str, Tensor]:
        """Return the parameters of K networks: {"tradeoff": (K, m)}, scaled to sum to one.

        Raises:
            MorlaxError: a trade-off is not finite or sums to zero (see `on_simplex`).
        """
        return {"tradeoff": on_simplex(tradeoffs)}

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run the network under K trade-offs, each on its own inputs (K, B, ...)."""
        (x,) = inputs
        rows = _beside(x, parameters["tradeoff"][:, None]).flatten(0, 1)
        return fused.mlp(rows, self._mlp, self.network).unflatten(0, x.shape[:2])

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run the network under one trade-off, {"tradeoff": (m,)}, on its inputs (B, ...)."""
        (x,) = inputs
        return self.network(_beside(x, parameters["tradeoff"]))

    def specialize(self, tradeoff: Tensor) -> nn.Module:
        """Return the network of one trade-off (m,), with parameters of its own."""
        return _Fixed(copy.deepcopy(self.network).to(tradeoff.device), on_simplex(tradeoff[None]))


class _Fixed(nn.Module):
    """The network under one trade-off (1, m)."""

    tradeoff: Tensor

    def __init__(self, network: nn.Module, tradeoff: Tensor):
        super().__init__()
        self.network = network
        self.register_buffer("tradeoff", tradeoff.clone())

    def forward(self, x: Tensor) -> Tensor:
        return self.network(_beside(x, self.tradeoff))


def _beside(x: Tensor, tradeoff: Tensor) -> Tensor:
    """Return x (..., inputs) with the trade-off (..., m) in every row, (..., inputs + m)."""
    # not `expand`: traced, it would fix the number of rows
    return torch.cat([x, torch.zeros_like(x[..., :1]) + tradeoff], -1)
