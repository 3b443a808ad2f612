"""What a scalarization is."""

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from ..gpu.group import ALONE, Group


class Scalarization(Protocol):
    """A utility u(w, r) of the returns r of m objectives under a trade-off w.

    Learners follow its gradient: with the expected returns of a policy, the derivative of u by the
    policy is that of every objective's return, weighed by du/dr (the chain rule). All methods run
    inside a recorded graph: fixed shapes, updates in place, no GPU sync.
    """

    uses_returns: bool
    """Whether the weights depend on the returns."""

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        """Return u (K,) of trade-offs (K, m) and expected returns (K, m)."""
        ...

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        """Return du/dr (K, m)."""
        ...

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        """Take note of expected returns (K, m) under trade-offs (K, m), before their `weights`."""
        ...

    def state(self) -> list[Tensor]:
        """Return the tensors that `observe` updates, in a fixed order."""
        ...

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        """Return numbers () to log by name, of objectives with these names."""
        ...
