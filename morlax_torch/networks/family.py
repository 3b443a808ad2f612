"""Families of networks, one network per condition: their interface, and conditioned networks.

A condition is a trade-off of m weights and, in families of robots whose bodies differ, d numbers of
context, which describe the body.
"""

import copy
from typing import Protocol

import torch
from torch import Tensor, nn

from ..envs import MorlaxError
from ..gpu import fused
from .mlp import mlp_sizes


class Family(Protocol):
    """A network for every condition: `Hypernetwork`, `Conditioned` or `Independent`.

    `run` may choose a fused kernel, which changes no result.
    """

    shapes: dict[str, torch.Size]
    """Parameters of the network that a user may have made, by name."""

    def __call__(self, conditions: Tensor) -> dict[str, Tensor]:
        """Map conditions (K, m + d) to parameters by name, (K, ...) each."""
        ...

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run K networks, each on its own inputs (K, B, ...), to outputs (K, B, ...)."""
        ...

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run one network, with parameters (...) each, on its inputs (B, ...)."""
        ...

    def specialize(self, condition: Tensor) -> nn.Module:
        """Return the plain network of one condition (m + d,)."""
        ...


def on_simplex(conditions: Tensor, num_objectives: int | None = None) -> Tensor:
    """Scale the trade-offs of conditions (K, m + d) to sum to one (None: d is 0).

    Raises:
        MorlaxError: a trade-off is not finite or sums to zero. Recorded and exported graphs cannot
            look at numbers, so there it gives numbers that are not finite.
    """
    m = num_objectives
    if m is not None and m < conditions.shape[-1]:
        return torch.cat([on_simplex(conditions[..., :m]), conditions[..., m:]], -1)
    sums = conditions.sum(-1, keepdim=True)
    capturing = torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
    recorded = capturing or torch.jit.is_tracing() or torch.compiler.is_compiling()
    if not (recorded or (conditions.isfinite() & (sums > 0)).all()):
        raise MorlaxError("a trade-off must be finite, and its weights must not sum to zero.")
    return conditions / sums


class Conditioned(nn.Module):
    """One network for every trade-off w, which it takes beside its input x: g(x, w).

    (AMOR: Alegre et al., 2025. A hypernetwork instead generates the network's parameters.) The
    network, which is copied, maps rows (B, inputs + m + d) to (B, outputs). `num_objectives` is m
    if conditions have a context.
    """

    def __init__(self, network: nn.Module, num_objectives: int | None = None):
        super().__init__()
        self._num_objectives = num_objectives
        self.network = copy.deepcopy(network)
        self.shapes = {name: value.shape for name, value in network.named_parameters()}
        self._mlp = mlp_sizes(network)

    def forward(self, conditions: Tensor) -> dict[str, Tensor]:
        """Return {"condition": (K, m + d)}; their trade-offs are scaled to sum to one."""
        return {"condition": on_simplex(conditions, self._num_objectives)}

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        (x,) = inputs
        rows = _beside(x, parameters["condition"][:, None]).flatten(0, 1)
        return fused.mlp(rows, self._mlp, self.network).unflatten(0, x.shape[:2])

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        (x,) = inputs
        return self.network(_beside(x, parameters["condition"]))

    def specialize(self, condition: Tensor) -> nn.Module:
        network = copy.deepcopy(self.network).to(condition.device)
        return _Fixed(network, on_simplex(condition[None], self._num_objectives))


class _Fixed(nn.Module):
    """The network under one condition (1, m + d)."""

    condition: Tensor

    def __init__(self, network: nn.Module, condition: Tensor):
        super().__init__()
        self.network = network
        self.register_buffer("condition", condition.clone())

    def forward(self, x: Tensor) -> Tensor:
        return self.network(_beside(x, self.condition))


def _beside(x: Tensor, condition: Tensor) -> Tensor:
    """Return x (..., inputs) with the condition (..., c) in every row, (..., inputs + c)."""
    # not `expand`: traced, it would fix the number of rows
    return torch.cat([x, torch.zeros_like(x[..., :1]) + condition], -1)
