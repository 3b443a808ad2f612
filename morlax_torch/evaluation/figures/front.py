"""Figures of fronts: the returns of the policies of a family."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from string import ascii_uppercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..front import Front
from ..pareto import conflicts, most_conflicting_pair
from .colors import of_objectives
from .style import (
    LEGEND_LETTER,
    between,
    blank,
    color_key,
    colors_of,
    distinct,
    fit,
    lattice,
    legend_outside,
    letter,
    limits,
    note,
    points,
    printed,
    returned,
    short,
    tint,
    weight,
)

MARKS = 25  # markers per line; they tell lines apart in grayscale
MOST_PAIRS = 6  # projections in a figure
MOST_LINES = 30  # policies in a figure of parallel coordinates
COLUMNS = 3
SIZE, PRINTED_SIZE = 14, 6  # of a point, in square points


def front_figure(
    front: Front,
    title: str = "",
    width: float | None = None,
    labels: Mapping[int, str] | None = None,
) -> Figure:
    """Plot the returns of every trade-off, colored by trade-off; dominated returns are gray.

    Two objectives give one plot. Three give the front in 3D and its three projections; more give
    one projection per pair of objectives, of at most MOST_PAIRS pairs that conflict most.

    Args:
        front: the front.
        title: title of the figure.
        width: width of the figure in inches (None: as wide as its plots need on a screen).
        labels: policies to mark with letters that the legend explains, by index.
    """
    names, labels = front.objectives, labels or {}
    m, entries = len(names), 1 + len(names) + len(labels)
    if m == 2:
        return _two(front, title, width, labels)
    pairs, all_pairs = most_conflicting(front), m * (m - 1) // 2
    if len(pairs) < all_pairs:
        title += f"{': ' if title else ''}the {len(pairs)} of {all_pairs} pairs that conflict most"
    if width is None:
        above, rows, columns = int(m == 3), -(-len(pairs) // COLUMNS), COLUMNS
        figure = blank(10.2, 3.3 * rows + (4.9 if above else 0.8), title)
    else:  # a plot in 3D is hard to read in print
        above, (figure, rows, columns) = 0, printed(width, len(pairs), entries, title)
    grid = figure.add_gridspec(above + rows, columns, height_ratios=[1.5] * above + [1] * rows)
    if above:
        axes: Any = figure.add_subplot(grid[0, :], projection="3d")
        best = front.non_dominated
        space(axes, front.returns[best], colors_of(front.tradeoffs[best]), names)
    for cell, (x, y) in enumerate(pairs):
        axes = figure.add_subplot(grid[above + cell // columns, cell % columns])
        _pair(axes, front, x, y, SIZE if width is None else PRINTED_SIZE, labels)
        if cell == 0:
            color_key(axes, names)
    legend_outside(figure)
    return figure


def most_conflicting(front: Front) -> list[tuple[int, int]]:
    """Return the pairs of objectives that conflict most, at most MOST_PAIRS, in their order."""
    pairs = list(combinations(range(len(front.objectives)), 2))
    conflict = conflicts(front.returns[front.non_dominated])
    ranked = sorted(pairs, key=lambda pair: -conflict[pair])
    return sorted(ranked[:MOST_PAIRS])


def map_figure(front: Front, width: float, height: float) -> tuple[Figure, Axes, tuple[int, int]]:
    """Plot the pair of objectives that conflicts most, in inches; returns its indices too."""
    x, y = most_conflicting_pair(front.returns[front.non_dominated])
    figure = blank(width, height, "")
    axes = figure.add_subplot()
    _pair(axes, front, x, y, SIZE, {})
    return figure, axes, (x, y)


def _two(front: Front, title: str, width: float | None, labels: Mapping[int, str]) -> Figure:
    entries = 1 + len(labels)
    figure = blank(5.4, 4.2, title) if width is None else printed(width, 1, entries, title)[0]
    axes, (first, second) = figure.add_subplot(), of_objectives(2)
    _pair(axes, front, 0, 1, SIZE if width is None else PRINTED_SIZE, labels)
    shade = ScalarMappable(Normalize(0, 1), between(second, first))
    figure.colorbar(shade, ax=axes, label=weight(front.objectives[0]))
    legend_outside(figure)
    return figure


def _pair(axes: Axes, front: Front, x: int, y: int, size: float, labels: Mapping[int, str]) -> None:
    best, colors = front.non_dominated, colors_of(front.tradeoffs)
    _label(axes, front.objectives, x, y)
    points(axes, front.returns[:, x], front.returns[:, y], best, size, colors[best])
    fit(axes, front.returns[:, x], front.returns[:, y])
    for number, (index, text) in enumerate(labels.items()):
        letter(axes, ascii_uppercase[number % 26], text, front.returns[index, [x, y]], number)


def _label(axes: Axes, names: Sequence[str], x: int, y: int) -> None:
    colors = of_objectives(len(names))
    axes.set(xlabel=returned(names[x]), ylabel=returned(names[y]))
    lattice(axes)
    tint(axes, colors[x], colors[y])


def parallel_figure(front: Front, title: str = "") -> Figure:
    """Plot each policy of the front as a line across one axis per objective.

    Each axis spans the front's lowest to highest return. A line has the color of the objective
    with the largest weight in its trade-off. Of many policies, MOST_LINES are shown.
    """
    names, best, shown = front.objectives, front.non_dominated, shown_lines(front)
    low, high = front.returns[best].min(0), front.returns[best].max(0)
    heights = (front.returns[shown] - low) / np.where(high > low, high - low, 1.0)
    chief = front.tradeoffs[shown].argmax(1)
    if len(shown) < best.sum():
        title += f"{': ' if title else ''}{len(shown)} of {best.sum()} policies of the front"
    column = max(1.6, LEGEND_LETTER * max(len(returned(name)) for name in names))
    figure = blank(2.2 + column * len(names), 4.6, title)
    axes = figure.add_subplot()
    at = np.arange(len(names))
    colors = of_objectives(len(names))
    for k, look in enumerate(distinct(len(names))):
        lines = [np.stack([at, row], -1) for row in heights[chief == k]]
        style: Any = {"color": colors[k], "linestyle": look["linestyle"]}
        axes.add_collection(LineCollection(lines, lw=0.8, alpha=0.7, **style))
        axes.plot([], [], lw=2, label=names[k], **style)
        axes.axvline(k, color=colors[k], lw=2.5)
        note(axes, f"{low[k]:.4g}", (k, 0), above=False)
        note(axes, f"{high[k]:.4g}", (k, 1), above=True)
    axes.set_xticks(at, [returned(name) for name in names])
    axes.tick_params(axis="x", length=0, pad=18)
    axes.set_yticks([0, 1], ["min", "max"])
    axes.set_ylabel("return, scaled to the range of the front")
    axes.set_ylim(-0.02, 1.02)
    axes.spines[:].set_visible(False)
    legend_outside(figure, "right center", title="largest weight")
    return figure


def shown_lines(front: Front) -> NDArray[np.intp]:
    """Return the policies of a parallel figure: the best of each objective, and even steps of all.

    There are at most MOST_LINES of them.
    """
    best = np.flatnonzero(front.non_dominated)
    if len(best) <= MOST_LINES:
        return best
    chosen = np.unique(best[front.returns[best].argmax(0)])[:MOST_LINES]
    others = np.setdiff1d(best, chosen)
    even = np.linspace(0, len(others) - 1, MOST_LINES - len(chosen)).round().astype(int)
    return np.sort(np.concatenate([chosen, others[even]]))


def fronts_figure(
    fronts: Mapping[str, Front], title: str = "", width: float | None = None
) -> Figure:
    """Overlay the fronts of several families, with one plot per pair of objectives.

    Of many pairs, only the MOST_PAIRS that conflict most in the first front are shown.

    Policies dominated within their own family are left out. With two objectives, a line connects
    the front, with markers on some of its points. All fronts must have the same objectives.
    """
    first = next(iter(fronts.values()))
    joined = len(first.objectives) == 2
    pairs = most_conflicting(first)
    if width is None:
        columns = min(len(pairs), COLUMNS)
        rows = -(-len(pairs) // columns)
        figure = blank(1.6 + 4.2 * columns, 3.9 * rows, title)
    else:
        figure, rows, columns = printed(width, len(pairs), len(fronts), title)
    for cell, (x, y) in enumerate(pairs, start=1):
        axes = figure.add_subplot(rows, columns, cell)
        for (name, front), look in zip(fronts.items(), distinct(len(fronts)), strict=True):
            returns = front.returns[front.non_dominated]
            order = returns[:, x].argsort()
            style: dict[str, Any] = {"lw": 0.8, "ms": 3.5, "alpha": 0.8, **look}
            style |= {"markevery": max(1, len(order) // MARKS)} if joined else {"linestyle": "none"}
            axes.plot(*returns[order][:, [x, y]].T, **style, label=name)
        _label(axes, first.objectives, x, y)
        shown = np.concatenate([each.returns[each.non_dominated] for each in fronts.values()])
        fit(axes, shown[:, x], shown[:, y])
    legend_outside(figure)
    return figure


def spaces_figure(front: Front, triples: Sequence[Sequence[str]], title: str = "") -> Figure:
    """Plot triples of objectives in 3D, in colors that mix those of the three by weight."""
    figure, names = blank(6.0 * len(triples), 5.6, title), front.objectives
    palette = of_objectives(len(names))
    for cell, triple in enumerate(triples, start=1):
        columns = [names.index(name) for name in triple]
        weights = front.tradeoffs[:, columns] + 1e-9
        shades = np.array([to_rgb(palette[column]) for column in columns])
        axes: Any = figure.add_subplot(1, len(triples), cell, projection="3d")
        colors = weights / weights.sum(1, keepdims=True) @ shades
        space(axes, front.returns[:, columns], colors, triple)
        for name, shade in zip(triple, shades, strict=True):
            axes.scatter([], [], [], s=40, color=[shade], label=f"weight on {name}")
    legend_outside(figure)
    return figure


def space(axes: Any, returns: NDArray, colors: NDArray, names: Sequence[str]) -> None:
    """Plot returns (K, 3) in colors (K, 3), without those beyond the limits of the axes."""
    bounds = [limits(column) for column in returns.T]
    low, high = np.transpose(bounds)
    kept = ((returns >= low) & (returns <= high)).all(1)
    axes.scatter(*returns[kept].T, s=16, c=colors[kept], depthshade=False)
    axes.set(xlim=bounds[0], ylim=bounds[1], zlim=bounds[2])
    for axis, name in zip("xyz", names, strict=True):
        getattr(axes, f"set_{axis}label")(returned(name), labelpad=10)
        getattr(axes, f"{axis}axis").set_major_formatter(short)
    axes.locator_params(nbins=5)
    axes.view_init(elev=25, azim=45)
    axes.set_box_aspect((1.3, 1.3, 1), zoom=0.97)  # else the label of the z axis is cut off
