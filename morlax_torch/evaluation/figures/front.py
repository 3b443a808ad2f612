"""Figures of fronts: the returns of the policies of a family."""

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure

from ..front import Front
from .style import COLORS, DOMINATED, blank, distinct, lattice, legend_outside, returned, weight

MARKS = 25  # markers per line; they tell lines apart in grayscale


def front_figure(front: Front, title: str = "") -> Figure:
    """Plot the returns of every trade-off, colored by trade-off; dominated returns are gray.

    Two objectives give one plot. Three give the front in 3D and its three projections; more give
    one projection per pair of objectives.
    """
    m = len(front.objectives)
    if m == 2:
        figure = blank(5.4, 4.2, title)
        points = _pair(figure.add_subplot(), front, 0, 1)
        figure.colorbar(points, ax=figure.axes, label=weight(front.objectives[0]))
        legend_outside(figure)
        return figure
    pairs = list(combinations(range(m), 2))
    columns = 2 if m == 3 else 3
    cells = len(pairs) + (m == 3)
    rows = -(-cells // columns)
    figure = blank(1.2 + 3.6 * columns, 3.5 * rows, title)
    if m == 3:
        _space(figure, front, rows, columns)
    for cell, (x, y) in enumerate(pairs, start=cells - len(pairs) + 1):
        points = _pair(figure.add_subplot(rows, columns, cell), front, x, y)
    label = "trade-off: weight of the x-axis objective relative to the pair"
    figure.colorbar(points, ax=figure.axes, label=label, aspect=40)
    legend_outside(figure)
    return figure


def _pair(axes: Axes, front: Front, x: int, y: int) -> PathCollection:
    best = front.non_dominated
    share = front.tradeoffs[:, x] / (front.tradeoffs[:, [x, y]].sum(1) + 1e-12)
    if not best.all():
        axes.scatter(*front.returns[~best][:, [x, y]].T, **DOMINATED)
    axes.set_xlabel(returned(front.objectives[x]))
    axes.set_ylabel(returned(front.objectives[y]))
    lattice(axes)
    return axes.scatter(
        *front.returns[best][:, [x, y]].T, s=14, c=share[best], cmap=COLORS, vmin=0, vmax=1
    )


def _space(figure: Figure, front: Front, rows: int, columns: int) -> None:
    best = front.non_dominated
    axes: Any = figure.add_subplot(rows, columns, 1, projection="3d")
    axes.scatter(
        *front.returns[best].T, s=12, c=front.tradeoffs[best, 2], cmap=COLORS, vmin=0, vmax=1
    )
    axes.set_xlabel(returned(front.objectives[0]), labelpad=8)
    axes.set_ylabel(returned(front.objectives[1]), labelpad=8)
    axes.set_zlabel(returned(front.objectives[2]), labelpad=6)
    axes.set_title(f"lighter: more weight on {front.objectives[2]}", fontsize="medium")
    axes.locator_params(nbins=4)
    axes.tick_params(labelsize="small")
    axes.view_init(elev=25, azim=45)
    axes.set_box_aspect(None, zoom=0.82)  # else the label of the z axis is cut off


def parallel_figure(front: Front, title: str = "") -> Figure:
    """Plot each policy of the front as a line across one axis per objective.

    Each axis spans the front's lowest to highest return. A line has the color of the objective
    with the largest weight in its trade-off.
    """
    names, best = front.objectives, front.non_dominated
    returns, chief = front.returns[best], front.tradeoffs[best].argmax(1)
    low, high = returns.min(0), returns.max(0)
    heights = (returns - low) / np.where(high > low, high - low, 1.0)
    figure = blank(1.4 + 1.8 * len(names), 4.2, title)
    axes = figure.add_subplot()
    at = np.arange(len(names))
    for k, look in enumerate(distinct(len(names))):
        lines = [np.stack([at, row], -1) for row in heights[chief == k]]
        axes.add_collection(
            LineCollection(lines, colors=[look["color"]], linestyles=[look["linestyle"]], lw=0.7)
        )
        axes.plot([], [], color=look["color"], linestyle=look["linestyle"], label=names[k])
        axes.axvline(k, color="0.2", lw=0.8)
        for height, value, side in ((0, low[k], "top"), (1, high[k], "bottom")):
            axes.annotate(
                f"{value:.4g}",
                (k, height),
                xytext=(0, -4 if side == "top" else 4),
                textcoords="offset points",
                ha="center",
                va=side,
                fontsize="small",
            )
    axes.set_xticks(at, [returned(name) for name in names])
    axes.tick_params(axis="x", length=0, pad=16)
    axes.set_yticks([0, 1], ["min", "max"])
    axes.set_ylabel("return, scaled to the range of the front")
    axes.set_ylim(-0.02, 1.02)
    axes.spines[:].set_visible(False)
    legend_outside(figure, "right center", title="largest weight")
    return figure


def fronts_figure(fronts: Mapping[str, Front], title: str = "") -> Figure:
    """Overlay the fronts of several families, with one plot per pair of objectives.

    Policies dominated within their own family are left out. With two objectives, a line connects
    the front, with markers on some of its points.

    Args:
        fronts: by name, all with the same objectives.
        title: of the figure.
    """
    names = next(iter(fronts.values())).objectives
    pairs = list(combinations(range(len(names)), 2))
    columns = min(len(pairs), 3)
    rows = -(-len(pairs) // columns)
    figure = blank(1.6 + 4.2 * columns, 3.9 * rows, title)
    for cell, (x, y) in enumerate(pairs, start=1):
        axes = figure.add_subplot(rows, columns, cell)
        for (name, front), look in zip(fronts.items(), distinct(len(fronts)), strict=True):
            returns = front.returns[front.non_dominated]
            order = returns[:, x].argsort()
            joined = len(names) == 2
            style: dict[str, Any] = {} if joined else {"linestyle": "none"}
            every = max(1, len(order) // MARKS) if joined else 1
            axes.plot(
                *returns[order][:, [x, y]].T,
                **(look | style),
                markevery=every,
                lw=0.8,
                ms=3.5,
                alpha=0.8,
                label=name,
            )
        axes.set_xlabel(returned(names[x]))
        axes.set_ylabel(returned(names[y]))
        lattice(axes)
    legend_outside(figure, "right upper")
    return figure
