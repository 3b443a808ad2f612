"""The interface of a family of networks: one network per trade-off."""

from typing import Protocol

from torch import Tensor, nn


class Family(Protocol):
    """One network for every trade-off. `Hypernetwork` is one.

    `run` may choose a fused kernel; `torch.vmap` over `torch.func.functional_call` defines its
    result.
    """

    def __call__(self, tradeoffs: Tensor) -> dict[str, Tensor]:
        """Map trade-offs (K, m) to parameters by name, (K, ...) each."""
        ...

    def run(self, parameters: dict[str, Tensor], *inputs: Tensor) -> Tensor:
        """Run K networks, each on its own inputs (K, B, ...), to outputs (K, B, ...)."""
        ...

    def specialize(self, tradeoff: Tensor) -> nn.Module:
        """Return the plain network of one trade-off (m,)."""
        ...
