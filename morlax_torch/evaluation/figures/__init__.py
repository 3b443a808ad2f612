"""Figures of fronts and training. Each function returns a matplotlib figure; `save` writes it."""

from .front import front_figure, fronts_figure, parallel_figure
from .hypervolume import hypervolume_figure
from .returns import returns_figure
from .style import save

__all__ = [
    "front_figure",
    "fronts_figure",
    "hypervolume_figure",
    "parallel_figure",
    "returns_figure",
    "save",
]
