"""Figures of the return of each objective against the trade-off."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from ..front import Front
from .colors import of_objectives
from .style import (
    Apart,
    blank,
    lattice,
    legend_outside,
    limits,
    note,
    points,
    returned,
    shades,
    short,
    tint,
    weight,
)

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(3) / 2]])  # of the simplex in the plot


def returns_figure(front: Front, title: str = "") -> Figure:
    """Plot the return of each objective over the simplex of trade-offs.

    With two objectives, both are plotted against the weight of the first. With three, each is a
    map of the simplex, whose corners put all weight on one objective. With more, each is plotted
    against its own weight.
    """
    m = len(front.objectives)
    if m == 2:
        return _curves(front, title)
    return _maps(front, title) if m == 3 else _own_weights(front, title)


def _curves(front: Front, title: str) -> Figure:
    figure = blank(5.4, 5.2, title)
    order = front.tradeoffs[:, 0].argsort()
    panels = figure.subplots(2, 1, sharex=True)
    for k, (axes, name) in enumerate(zip(panels, front.objectives, strict=True)):
        x, y = front.tradeoffs[order, 0], front.returns[order, k]
        best = front.non_dominated[order]
        axes.plot(x, y, color="0.6", lw=0.8)
        points(axes, x, y, best, 10, of_objectives(2)[k])
        axes.set_ylabel(returned(name))
        lattice(axes)
        tint(axes, of_objectives(2)[0], of_objectives(2)[k])
    panels[1].set_xlabel(weight(front.objectives[0]))
    legend_outside(figure)
    return figure


def _maps(front: Front, title: str) -> Figure:
    names = front.objectives
    figure = blank(11.0, 4.0, title)
    simplex = Triangulation(*(front.tradeoffs @ CORNERS).T)
    for k, axes in enumerate(figure.subplots(1, 3)):
        colors = axes.tripcolor(
            simplex,
            front.returns[:, k],
            cmap=shades(of_objectives(3)[k]),
            shading="flat",
            edgecolors="face",
            lw=0.2,
        )
        for corner, name in enumerate(names):
            style = {"fontweight": "bold"} if corner == k else {}
            note(axes, f"{name} only", CORNERS[corner], above=corner == 2, **style)
        axes.plot(*CORNERS[[0, 1, 2, 0]].T, color="0.2", lw=0.8)
        axes.set(aspect="equal", xlim=(-0.15, 1.15), ylim=(-0.08, 0.95))
        axes.set_axis_off()
        place: Any = {"location": "bottom", "shrink": 0.7, "ticks": Apart(), "format": short}
        figure.colorbar(colors, ax=axes, label=returned(names[k]), **place)
    return figure


def _own_weights(front: Front, title: str) -> Figure:
    m = len(front.objectives)
    columns, colors = min(m, 3), of_objectives(m)
    figure = blank(3.4 * columns, 3.5 * -(-m // columns), title)
    for k, name in enumerate(front.objectives):
        axes = figure.add_subplot(-(-m // columns), columns, k + 1)
        best = front.non_dominated
        x, y = front.tradeoffs[:, k], front.returns[:, k]
        points(axes, x, y, best, 10, colors[k])
        axes.set(xlabel=f"weight of {name}", ylabel=returned(name), ylim=limits(y[best]))
        lattice(axes)
        tint(axes, colors[k], colors[k])
    legend_outside(figure)
    return figure
