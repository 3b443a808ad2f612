"""How a trade-off turns several objectives into one."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor


class Scalarization(Protocol):
    """A utility u(w, r) of the returns r of m objectives under a trade-off w.

    `weights` runs inside a recorded graph: fixed shapes, updates in place, no GPU sync.
    """

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        """Return du/dr (K, m) at trade-offs (K, m) and expected returns (K, m)."""
        ...

    def utility(self, tradeoffs: ArrayLike, returns: ArrayLike) -> NDArray[np.float64]:
        """Return u (k, n) for trade-offs (k, m) and returns (n, m)."""
        ...

    def state(self) -> list[Tensor]:
        """Return the tensors that future weights depend on, in a fixed order."""
        ...


class Linear:
    """The weighted sum u(w, r) = w . r."""

    def weights(self, tradeoffs: Tensor, returns: Tensor) -> Tensor:
        return tradeoffs

    def utility(self, tradeoffs: ArrayLike, returns: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(tradeoffs, np.float64) @ np.asarray(returns, np.float64).T

    def state(self) -> list[Tensor]:
        return []
