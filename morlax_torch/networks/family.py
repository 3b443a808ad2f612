"""The interface of a family of networks: one network per trade-off."""

from typing import Protocol

import torch
from torch import Tensor, nn

from ..envs import MorlaxError


class Family(Protocol):
    """A network for every trade-off: `Hypernetwork`, `Conditioned` or `Independent`.

    `run` may choose a fused kernel, which changes no result.
    """

    shapes: dict[str, torch.Size]
    """Parameters of the network that a user may have made, by name."""

    def __call__(self, tradeoffs: Tensor) -> dict[str, Tensor]:
        """Map trade-offs (K, m) to parameters by name, (K, ...) each."""
        ...

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run K networks, each on its own inputs (K, B, ...), to outputs (K, B, ...)."""
        ...

    def run_one(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run one network, with parameters (...) each, on its inputs (B, ...)."""
        ...

    def specialize(self, tradeoff: Tensor) -> nn.Module:
        """Return the plain network of one trade-off (m,)."""
        ...


def on_simplex(tradeoffs: Tensor) -> Tensor:
    """Scale trade-offs (K, m) to sum to one.

    Raises:
        MorlaxError: a trade-off is not finite or sums to zero. Recorded and exported graphs cannot
            look at numbers, so there it gives numbers that are not finite.
    """
    if not (_is_recorded() or (tradeoffs.isfinite() & (tradeoffs.sum(-1, True) > 0)).all()):
        raise MorlaxError("a trade-off must be finite, and its weights must not sum to zero.")
    return tradeoffs / tradeoffs.sum(-1, keepdim=True)


def _is_recorded() -> bool:
    """Return whether torch only records the operations, and no number exists yet."""
    capturing = torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
    return capturing or torch.jit.is_tracing() or torch.compiler.is_compiling()
