"""The interface of a family of networks: one network per condition.

A condition is a trade-off of m weights and, in families of robots whose bodies differ, d numbers of
context, which describe the body.
"""

from typing import Protocol

import torch
from torch import Tensor, nn

from ..envs import MorlaxError


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
    if not (_is_recorded() or (conditions.isfinite() & (conditions.sum(-1, True) > 0)).all()):
        raise MorlaxError("a trade-off must be finite, and its weights must not sum to zero.")
    return conditions / conditions.sum(-1, keepdim=True)


def _is_recorded() -> bool:
    """Return whether torch only records the operations, and no number exists yet."""
    capturing = torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
    return capturing or torch.jit.is_tracing() or torch.compiler.is_compiling()
