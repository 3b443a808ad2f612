"""Weighted sums."""

from collections.abc import Sequence

from torch import Tensor

from ..gpu.group import ALONE, Group


class Linear:
    """The weighted sum u(w, r) = w . r, whose best policies lie on the convex part of a front."""

    uses_returns = False

    def utility(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return (tradeoffs * returns).sum(-1)

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return tradeoffs

    def observe(self, tradeoffs: Tensor, returns: Tensor, group: Group = ALONE) -> None:
        pass

    def state(self) -> list[Tensor]:
        return []

    def metrics(self, objectives: Sequence[str]) -> dict[str, Tensor]:
        return {}
