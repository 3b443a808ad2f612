"""Figures of fronts and training. Each function returns a matplotlib figure.

`save` writes it to files, `pixels` renders it to an array.
"""

from .front import (
    designs_figure,
    front_figure,
    fronts_figure,
    hypervolume_figure,
    parallel_figure,
    quantities_figure,
    returns_figure,
    shown_lines,
    spaces_figure,
)
from .style import STYLES, pixels, save

__all__ = [
    "STYLES",
    "designs_figure",
    "front_figure",
    "fronts_figure",
    "hypervolume_figure",
    "parallel_figure",
    "pixels",
    "quantities_figure",
    "returns_figure",
    "save",
    "shown_lines",
    "spaces_figure",
]
