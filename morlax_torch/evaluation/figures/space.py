"""Three objectives in 3D."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...colors import of_objectives
from ..front import Front
from .style import blank, legend_outside, limits, returned


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
    """Plot returns (K, 3) in 3D, without those beyond the limits of the axes.

    Args:
        axes: with a 3D projection.
        returns: (K, 3)
        colors: (K, 3), of the points.
        names: of the three objectives.
    """
    bounds = [limits(column) for column in returns.T]
    inside = [
        (column >= low) & (column <= high)
        for column, (low, high) in zip(returns.T, bounds, strict=True)
    ]
    kept = inside[0] & inside[1] & inside[2]
    axes.scatter(*returns[kept].T, s=16, c=colors[kept], depthshade=False)
    axes.set(xlim=bounds[0], ylim=bounds[1], zlim=bounds[2])
    for axis, name in zip("xyz", names, strict=True):
        getattr(axes, f"set_{axis}label")(returned(name), labelpad=10)
    axes.locator_params(nbins=5)
    axes.view_init(elev=25, azim=45)
    axes.set_box_aspect((1.3, 1.3, 1), zoom=0.97)  # else the label of the z axis is cut off
