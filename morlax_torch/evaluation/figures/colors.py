"""Colors of objectives and trade-offs, the same in figures, reports and the explorer."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# of Okabe and Ito: distinct to color-blind readers too
PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
GRAY, PALE, INK = "#c4cad3", "#e3e7ec", "#495057"


def of_objectives(m: int) -> list[str]:
    """Return a color for each objective, as #rrggbb."""
    return [PALETTE[i % len(PALETTE)] for i in range(m)]


def mixed(weights: ArrayLike) -> NDArray[np.float64]:
    """Return the colors (..., 3) in [0, 1] of trade-offs (..., m): the objectives', by weight."""
    weights = np.asarray(weights)
    shares = weights / weights.sum(-1, keepdims=True)
    colors = of_objectives(shares.shape[-1])
    return shares @ [[int(c[k : k + 2], 16) / 255 for k in (1, 3, 5)] for c in colors]
