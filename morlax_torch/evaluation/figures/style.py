"""Shared style of figures: colors that work in grayscale, axis labels, files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...files import replacing

COLORS = "viridis"  # perceptually uniform: readable in grayscale and by color-blind readers
DOMINATED = {"s": 9, "color": "0.65", "marker": "x", "lw": 0.7, "label": "dominated"}
MARKERS = "osD^vPX*"
LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
FORMATS = ("png", "pdf")
# journals require embedded TrueType fonts (type 42); the salt makes SVG files reproducible
FILES: Any = {"pdf.fonttype": 42, "svg.hashsalt": "morlax"}


def blank(width: float, height: float, title: str) -> Figure:
    """Create an empty figure; width and height are in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize="large")
    return figure


def lattice(axes: Axes) -> None:
    """Draw a thin grid behind everything else."""
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)


def distinct(number: int) -> list[dict[str, Any]]:
    """Return a color, marker and line style for each of `number` items."""
    shades = mpl.colormaps[COLORS]([0.85 * k / max(number - 1, 1) for k in range(number)])
    return [
        {"color": shade, "marker": MARKERS[k % len(MARKERS)], "linestyle": LINES[k % len(LINES)]}
        for k, shade in enumerate(shades)
    ]


def legend_outside(figure: Figure, side: str = "lower center", title: str | None = None) -> None:
    """Draw one legend for all plots outside them; none if nothing has a label.

    Args:
        figure: with its plots.
        side: location, as matplotlib names it after "outside".
        title: of the legend.
    """
    names: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            names.setdefault(label, handle)
    if names:
        place: Any = f"outside {side}"
        figure.legend([*names.values()], [*names], loc=place, title=title, frameon=False)


def returned(objective: str) -> str:
    """Return the label of an axis of returns, which have the unit of the reward."""
    return f"{objective} (return)"


def weight(objective: str) -> str:
    """Return the label of an axis of trade-offs."""
    return f"trade-off: weight of {objective}"


def save(figure: Figure, stem: Path, formats: Sequence[str] = FORMATS) -> None:
    """Write stem.png, stem.pdf, stem.svg, ...; a failed write leaves the previous file intact.

    Args:
        figure: to write.
        stem: path without a suffix.
        formats: suffixes of the files.

    Raises:
        MorlaxError: a file cannot be written.
    """
    for ending in formats:
        dates = {"png": {}, "svg": {"Date": None}}.get(ending, {"CreationDate": None})
        with mpl.rc_context(FILES), replacing(stem.with_name(f"{stem.name}.{ending}")) as file:
            figure.savefig(file, format=ending, dpi=150, metadata=dates)


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """Render a figure to (height, width, 3), without pyplot, so that any thread may do it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]
