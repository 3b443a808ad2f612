"""Figure of the common front of many bodies."""

from collections.abc import Sequence

from matplotlib.figure import Figure
from numpy.typing import NDArray

from .. import pareto
from .style import RUNS, blank, fit, lattice, legend_outside, returned

COLUMNS = 3


def designs_figure(
    objectives: Sequence[str],
    returns: NDArray,
    designs: NDArray,
    parameters: Sequence[str],
    usual: NDArray,
    title: str = "",
) -> Figure:
    """Plot the common front of many bodies, colored by each design parameter in turn.

    So it shows which bodies win where. Axes are the two objectives that conflict most.

    Args:
        objectives: m names.
        returns: of the policies on the front, (n, m).
        designs: of their bodies, (n, d).
        parameters: d names with units, such as "thigh (m)".
        usual: returns of the front of the default body (k, m), for comparison.
    """
    x, y = pareto.most_conflicting_pair(returns)
    columns = min(COLUMNS, len(parameters))
    rows = -(-len(parameters) // columns)
    figure = blank(3.6 * columns, 3.1 * rows + 0.5, title)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    order = usual[:, x].argsort()
    for axes, values, name in zip(grid, designs.T, parameters, strict=False):
        axes.plot(*usual[order][:, [x, y]].T, "-", color="0.6", lw=1, label="default body")
        marks = axes.scatter(returns[:, x], returns[:, y], c=values, cmap=RUNS, s=14)
        fit(axes, returns[:, x], returns[:, y])
        figure.colorbar(marks, ax=axes, label=name)
        axes.set(xlabel=returned(objectives[x]), ylabel=returned(objectives[y]))
        lattice(axes)
    for axes in grid[len(parameters) :]:
        axes.set_axis_off()
    legend_outside(figure)
    return figure
