"""What the figures share: colours that survive grey print, names of axes, files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...files import replacing

COLOURS = "viridis"  # even in lightness: readable in grey and by the colour-blind
DOMINATED = {"s": 9, "color": "0.65", "marker": "x", "lw": 0.7, "label": "dominated"}
MARKERS = "osD^vPX*"
LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
FORMATS = ("png", "pdf")
# what journals ask for: fonts that stay text, and the same file from the same numbers
FILES: Any = {"pdf.fonttype": 42, "svg.hashsalt": "morlax"}


def blank(width: float, height: float, title: str) -> Figure:
    """A figure of so many inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize="large")
    return figure


def lattice(axes: Axes) -> None:
    """Thin lines to read values by, behind everything else."""
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)


def distinct(number: int) -> list[dict[str, Any]]:
    """Colour, marker and line style for each of so many things."""
    shades = mpl.colormaps[COLOURS]([0.85 * k / max(number - 1, 1) for k in range(number)])
    return [
        {"color": shade, "marker": MARKERS[k % len(MARKERS)], "linestyle": LINES[k % len(LINES)]}
        for k, shade in enumerate(shades)
    ]


def legend_outside(figure: Figure, side: str = "lower center", title: str | None = None) -> None:
    """One legend for all plots, where it hides no point; none where nothing has a name."""
    names: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            names.setdefault(label, handle)
    if names:
        place: Any = f"outside {side}"
        figure.legend([*names.values()], [*names], loc=place, title=title, frameon=False)


def returned(objective: str) -> str:
    """The name of an axis of returns, which have no unit but reward."""
    return f"{objective} (return)"


def weight(objective: str) -> str:
    """The name of an axis of trade-offs."""
    return f"trade-off: weight of {objective}"


def save(figure: Figure, stem: Path, formats: Sequence[str] = FORMATS) -> None:
    """Write stem.png, stem.pdf, stem.svg, ...: each is as it was or complete.

    Raises:
        MorlaxError: a file cannot be written.
    """
    for ending in formats:
        dates = {"png": {}, "svg": {"Date": None}}.get(ending, {"CreationDate": None})
        with mpl.rc_context(FILES), replacing(stem.with_name(f"{stem.name}.{ending}")) as file:
            figure.savefig(file, format=ending, dpi=150, metadata=dates)
