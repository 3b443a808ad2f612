"""The interface of a scalarization, and the weighted sum."""

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from ...gpu.group import ALONE, Group


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

    def state(self) -> list[Tensor]:
        """Return the tensors that `observe` updates, in a fixed order."""
        return []

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        """Return numbers () to log by name, of objectives with these names."""
        return {}


class Linear(Scalarization):
    """The weighted sum u(w, r) = w . r, whose best policies lie on the convex part of a front."""

    uses_returns = False

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return (tradeoffs * returns).sum(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return tradeoffs
