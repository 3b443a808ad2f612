"""Colors of objectives and trade-offs."""

import numpy as np
from numpy.typing import ArrayLike

# of Okabe and Ito: distinct to color-blind readers too
PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
GRAY, INK = "#9aa3ad", "currentColor"  # readable on light and on dark pages


def of_objectives(m: int) -> list[str]:
    """Return a color for each objective, as #rrggbb."""
    return [PALETTE[i % len(PALETTE)] for i in range(m)]


def mix(weights: ArrayLike) -> str:
    """Return the color of a trade-off (m,): the objectives' colors, mixed by weight."""
    shares = np.asarray(weights) / np.sum(weights)
    channels = [[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in of_objectives(len(shares))]
    red, green, blue = np.round(shares @ channels).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"
