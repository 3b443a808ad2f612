"""Shared style of figures: colors that work in grayscale, axis labels, files."""

import math
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, EngFormatter
from numpy.typing import NDArray

from ..host.files import replacing
from .front import Front

# of objectives, by Okabe and Ito: distinct to color-blind readers too
PALETTE = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9")
SHADES = ("Blues", "Oranges", "Greens")  # maps from white to dark, of its first three
INK = "#495057"
RUNS = "viridis"  # perceptually uniform, and unlike the colors of objectives
DOMINATED = {"s": 7, "color": "0.7", "lw": 0, "label": "dominated"}  # crosses mean falls
NON_DOMINATED = "_non-dominated"  # a label that no legend shows
FALLS = {"marker": "x", "lw": 0.9, "s": 14, "color": "0.5", "label": "falls in most episodes"}
MARKERS = "osD^vP<*"
LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
FORMATS = ("png", "pdf")
MOST_MIXED = 3  # objectives whose colors a trade-off mixes
LEGEND_MARK, LEGEND_LETTER = 0.7, 0.09  # inches
OUTLYING = (0.01, 0.99)  # quantiles between which the bulk of the values lies
BULK = 0.7  # share of the range, below which an axis leaves out values beyond the bulk
# journals require embedded TrueType fonts (type 42); the salt makes SVG files reproducible
FILES: Any = {"pdf.fonttype": 42, "svg.hashsalt": "morlax"}


class Apart(AutoLocator):
    """Chooses so few ticks of a horizontal axis that labels of `short` do not collide."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        assert self.axis is not None
        # matplotlib allows labels 3 font sizes, but those of `short` are wider
        self.set_params(nbins=max(1, self.axis.get_tick_space() * 2 // 3), min_n_ticks=1)
        return super().tick_values(vmin, vmax)


def blank(width: float, height: float, title: str) -> Figure:
    """Create an empty figure; width and height are in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize="large")
    return figure


def panels(
    number: int, columns: int, size: tuple[float, float], title: str, room: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """Create a figure of so many plots of a size, and `room` beside them, in inches."""
    columns = min(number, columns)
    rows = math.ceil(number / columns)
    figure = blank(size[0] * columns, size[1] * rows + room, title)
    return figure, [figure.add_subplot(rows, columns, cell + 1) for cell in range(number)]


def lattice(axes: Axes, across: str, up: str = "", colors: Sequence[str] = ()) -> None:
    """Label both axes, give them colors if there are any, and draw a grid."""
    axes.set(xlabel=across, ylabel=up)
    for side, color in zip(("bottom", "left"), colors, strict=False):
        axes.spines[side].set(color=color, linewidth=2.5)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    axes.xaxis.set_major_locator(Apart())
    axes.xaxis.set_major_formatter(short)


def short(value: float, position: float = 0) -> str:
    """Return the label of a tick, without a power of ten beside the axis, which hides its label."""
    if 1e-3 <= abs(value) < 1e5 or value == 0:
        return f"{value:g}".replace("-", "\N{MINUS SIGN}")
    return EngFormatter(sep="")(value)


def points(axes: Axes, front: Front, x: NDArray, y: NDArray, size: float, colors: NDArray) -> None:
    """Draw a front's best policies in `colors` (K, ...), others in gray, and crosses for falls."""
    best, fails = front.non_dominated, front.fails
    for some, look in ((~best & ~fails, DOMINATED), (fails, FALLS)):
        if some.any():
            axes.scatter(x[some], y[some], **look)
    some = best & ~fails
    axes.scatter(x[some], y[some], s=size, color=colors[some], label=NON_DOMINATED)


def note(axes: Axes, text: str, point: Any, above: bool = True, **style: Any) -> None:
    """Write a text above or below a point, unless the point lies outside the axes."""
    offset, side = (4, "bottom") if above else (-4, "top")
    style |= {"ha": "center", "va": side, "textcoords": "offset points"}
    axes.annotate(text, tuple(point), (0, offset), **style)


def of_objectives(m: int) -> list[str]:
    """Return a color for each objective, as #rrggbb."""
    return [PALETTE[i % len(PALETTE)] for i in range(m)]


def distinct(number: int) -> list[dict[str, Any]]:
    """Return colors, markers and lines that tell so many curves apart."""
    colors = mpl.colormaps[RUNS](np.linspace(0, 0.85, number))
    looks = zip(colors, cycle(MARKERS), cycle(LINES), strict=False)
    return [{"color": color, "marker": mark, "linestyle": line} for color, mark, line in looks]


def colors_of(tradeoffs: NDArray) -> NDArray[np.float64]:
    """Return a color (K, 3) for each trade-off (K, m).

    Up to three objectives mix their colors by weight. A mix of more would be gray, so the
    objective with the largest weight gives its own.
    """
    m = tradeoffs.shape[1]
    weights = tradeoffs if m <= MOST_MIXED else np.eye(m)[tradeoffs.argmax(1)]
    palette = [to_rgb(color) for color in of_objectives(m)]
    return weights / weights.sum(1, keepdims=True) @ palette


def color_key(axes: Axes, names: Sequence[str]) -> None:
    meaning = f"{'all' if len(names) <= MOST_MIXED else 'most'} weight on"
    for name, color in zip(names, of_objectives(len(names)), strict=True):
        axes.scatter([], [], s=40, color=color, label=f"{meaning} {name}")


def limits(values: NDArray) -> tuple[float, float]:
    """Return the limits of an axis: the range of finite values, or its bulk if few lie far off."""
    values = values[np.isfinite(values)] if np.isfinite(values).any() else np.zeros(1)
    low, high = float(values.min()), float(values.max())
    first, last = np.quantile(values, OUTLYING)
    if last - first < BULK * (high - low):
        low, high = max(low, first - (last - first) / 4), min(high, last + (last - first) / 4)
    margin = 0.04 * (high - low) or 1.0
    return low - margin, high + margin


def fit(axes: Axes, x: NDArray, y: NDArray) -> None:
    """Set the limits of both axes, and say how many points lie outside."""
    across, up = limits(x), limits(y)
    axes.set(xlim=across, ylim=up)
    outside = (x < across[0]) | (x > across[1]) | (y < up[0]) | (y > up[1])
    if outside.any():
        axes.set_title(f"{outside.sum()} outside", loc="left", color=INK, fontsize="small")


def legend_outside(figure: Figure, side: str = "lower center", title: str | None = None) -> None:
    """Draw one legend for all plots outside them, at a side as matplotlib names it."""
    names: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            names.setdefault(label, handle)
    if not names:
        return
    location: Any = f"outside {side}"
    letters = LEGEND_MARK + LEGEND_LETTER * max(map(len, names))
    columns = 1 if "right" in side else max(1, int(figure.get_figwidth() / letters))
    figure.legend(
        [*names.values()], [*names], loc=location, title=title, frameon=False, ncols=columns
    )


def returned(objective: str) -> str:
    return f"{objective} (return)"


def weight(objective: str) -> str:
    return f"trade-off: weight of {objective}"


def save(figure: Figure, stem: Path, formats: Sequence[str] = FORMATS) -> None:
    """Write stem.png and stem.pdf; a failed write leaves the previous file intact."""
    for ending in formats:
        dates = {} if ending == "png" else {"CreationDate": None}
        with mpl.rc_context(FILES), replacing(stem.with_name(f"{stem.name}.{ending}")) as file:
            figure.savefig(file, format=ending, dpi=150, metadata=dates)


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """Render a figure to (height, width, 3), without pyplot, so that any thread may do it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]
