"""Figures of what policies do in physical units."""

from matplotlib.figure import Figure

from ..front import Front
from .style import blank, color_key, colors_of, fit, lattice, legend_outside, points

COLUMNS = 2


def quantities_figure(front: Front, title: str = "") -> Figure:
    """Plot each measured quantity of every trade-off against the first one, colored by trade-off.

    Policies with dominated returns are gray.
    """
    assert front.quantities is not None
    across, *others = front.quantities.T
    rows = -(-len(others) // COLUMNS)
    figure = blank(8.0, 3.3 * rows + 0.8, title)
    best, colors = front.non_dominated, colors_of(front.tradeoffs)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, values, name in zip(grid, others, front.quantity_names[1:], strict=False):
        points(axes, across, values, best, 14, colors[best])
        fit(axes, across, values)
        axes.set(xlabel=front.quantity_names[0], ylabel=name)
        lattice(axes)
    for axes in grid[len(others) :]:
        axes.set_axis_off()
    color_key(grid[0], front.objectives)
    legend_outside(figure)
    return figure
