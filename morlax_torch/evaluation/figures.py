"""Figures of fronts, of what their policies do, and of the hypervolume during training.

Each function returns a matplotlib figure. `save` writes it to files, `pixels` renders it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from . import style
from .front import Front
from .pareto import conflicting_pairs
from .style import pixels as pixels
from .style import save as save

MARKS = 25  # markers per line; they tell lines apart in grayscale
MOST_PAIRS = 6  # projections in a figure
MOST_LINES = 30  # policies in a figure of parallel coordinates
COLUMNS = 3
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(3) / 2]])  # of the simplex in the plot
SIZE = 14  # of a point, in square points
SCALES = (("env_steps", "environment steps"), ("train_seconds", "training time (s)"))


def front_figure(front: Front, title: str = "") -> Figure:
    """Plot the returns of every trade-off, colored by trade-off; dominated returns are gray.

    Two objectives give one plot. Three give the front in 3D and its three projections; more give
    one projection per pair of objectives, of at most MOST_PAIRS pairs that conflict most.
    """
    names, m = front.shown, len(front.objectives)
    pairs = conflicting_pairs(front.returns[front.non_dominated], MOST_PAIRS)
    all_pairs = m * (m - 1) // 2
    if len(pairs) < all_pairs:
        title += f"{': ' if title else ''}the {len(pairs)} of {all_pairs} pairs that conflict most"
    if m == 3:
        figure = style.blank(10.2, 8.2, title)
        grid = figure.add_gridspec(2, 3, height_ratios=[1.5, 1])
        _space(figure.add_subplot(grid[0, :], projection="3d"), front)
        plots = [figure.add_subplot(grid[1, column]) for column in range(3)]
    else:
        plot, room = ((5.4, 4.2), 0.0) if m == 2 else ((3.4, 3.3), 0.8)
        figure, plots = style.panels(len(pairs), COLUMNS, plot, title, room)
    for axes, pair in zip(plots, pairs, strict=True):
        _pair(axes, front, pair)
    if m == 2:
        colors = LinearSegmentedColormap.from_list("between", style.of_objectives(2)[::-1])
        shade = ScalarMappable(Normalize(0, 1), colors)
        figure.colorbar(shade, ax=plots[0], label=style.weight(names[0]))
    else:
        style.color_key(plots[0], names)
    style.legend_outside(figure)
    return figure


def map_figure(front: Front, width: float, height: float) -> tuple[Figure, Axes, tuple[int, int]]:
    """Plot the pair of objectives that conflicts most, in inches; returns its indices too."""
    (pair,) = conflicting_pairs(front.returns[front.non_dominated])
    figure = style.blank(width, height, "")
    axes = figure.add_subplot()
    _pair(axes, front, pair)
    return figure, axes, pair


def _pair(axes: Axes, front: Front, pair: tuple[int, int]) -> None:
    x, y = front.returns[:, pair].T
    label_axes(axes, front.shown, pair)
    style.points(axes, front, x, y, SIZE, style.colors_of(front.tradeoffs))
    style.fit(axes, x, y)


def label_axes(axes: Axes, names: Sequence[str], pair: tuple[int, int]) -> None:
    colors = style.of_objectives(len(names))
    across, up = (style.returned(names[k]) for k in pair)
    style.lattice(axes, across, up, [colors[k] for k in pair])


def parallel_figure(front: Front, title: str = "") -> Figure:
    """Plot each policy of the front as a line across one axis per objective.

    Each axis spans the front's lowest to highest return. A line has the color of the objective
    with the largest weight in its trade-off. Of many policies, MOST_LINES are shown.
    """
    names, best, shown = front.shown, front.non_dominated, shown_lines(front)
    low, high = front.returns[best].min(0), front.returns[best].max(0)
    heights = (front.returns[shown] - low) / np.where(high > low, high - low, 1.0)
    chief = front.tradeoffs[shown].argmax(1)
    if len(shown) < best.sum():
        title += f"{': ' if title else ''}{len(shown)} of {best.sum()} policies of the front"
    column = max(1.6, style.LEGEND_LETTER * max(len(style.returned(name)) for name in names))
    figure = style.blank(2.2 + column * len(names), 4.6, title)
    axes = figure.add_subplot()
    colors = style.of_objectives(len(names))
    for k, look in enumerate(style.distinct(len(names))):
        line: Any = {"color": colors[k], "linestyle": look["linestyle"]}
        axes.plot(heights[chief == k].T, lw=0.8, alpha=0.7, **line)
        axes.plot([], [], lw=2, label=names[k], **line)
        axes.axvline(k, color=colors[k], lw=2.5)
        style.note(axes, f"{low[k]:.4g}", (k, 0), above=False)
        style.note(axes, f"{high[k]:.4g}", (k, 1), above=True)
    axes.set_xticks(range(len(names)), [style.returned(name) for name in names])
    axes.tick_params(axis="x", length=0, pad=18)
    axes.set_yticks([0, 1], ["min", "max"])
    axes.set(ylabel="return, scaled to the range of the front", ylim=(-0.02, 1.02))
    axes.spines[:].set_visible(False)
    style.legend_outside(figure, "right center", title="largest weight")
    return figure


def shown_lines(front: Front) -> NDArray[np.intp]:
    """Return at most MOST_LINES policies: the best of each objective, and even steps of all."""
    best = np.flatnonzero(front.non_dominated)
    if len(best) <= MOST_LINES:
        return best
    chosen = best[front.returns[best].argmax(0)][:MOST_LINES]
    even = np.linspace(0, len(best) - 1, MOST_LINES - len(chosen)).round().astype(int)
    return np.union1d(chosen, best[even])


def fronts_figure(fronts: Mapping[str, Front], title: str = "") -> Figure:
    """Overlay the fronts of families with the same objectives, with one plot per pair of these.

    Of many pairs, only the MOST_PAIRS that conflict most in the first front are shown. Policies
    dominated within their own family are left out. With two objectives, a line connects the front.
    """
    best = {name: front.returns[front.non_dominated] for name, front in fronts.items()}
    names, joined = next(iter(fronts.values())).shown, np.concatenate([*best.values()])
    pairs = conflicting_pairs(next(iter(best.values())), MOST_PAIRS)
    figure, plots = style.panels(len(pairs), COLUMNS, (4.2, 3.9), title)
    for axes, pair in zip(plots, pairs, strict=True):
        for (name, returns), look in zip(best.items(), style.distinct(len(best)), strict=True):
            line: dict[str, Any] = {"lw": 0.8, "ms": 3.5, "alpha": 0.8, **look}
            if len(names) == 2:
                line["markevery"] = max(1, len(returns) // MARKS)
            else:
                line["linestyle"] = "none"
            ordered = returns[returns[:, pair[0]].argsort()]
            axes.plot(*ordered[:, pair].T, **line, label=name)
        label_axes(axes, names, pair)
        style.fit(axes, *joined[:, pair].T)
    style.legend_outside(figure)
    return figure


def _space(axes: Any, front: Front) -> None:
    """Plot the front of three objectives, without policies beyond the limits of the axes."""
    returns = front.returns[front.non_dominated]
    bounds = [style.limits(column) for column in returns.T]
    low, high = np.transpose(bounds)
    kept = ((returns >= low) & (returns <= high)).all(1)
    colors = style.colors_of(front.tradeoffs[front.non_dominated][kept])
    axes.scatter(*returns[kept].T, s=16, c=colors, depthshade=False)
    axes.set(xlim=bounds[0], ylim=bounds[1], zlim=bounds[2])
    for axis, name in zip("xyz", front.shown, strict=True):
        getattr(axes, f"set_{axis}label")(style.returned(name), labelpad=10)
        getattr(axes, f"{axis}axis").set_major_formatter(style.short)
    axes.locator_params(nbins=5)
    axes.view_init(elev=25, azim=45)
    axes.set_box_aspect((1.3, 1.3, 1), zoom=0.97)  # else the label of the z axis is cut off


def designs_figure(
    objectives: Sequence[str],
    returns: NDArray,
    designs: NDArray,
    parameters: Sequence[str],
    usual: NDArray,
) -> Figure:
    """Plot the common front (n, m) of many bodies, colored by each of d design parameters in turn.

    Axes are the two objectives that conflict most. `designs` are (n, d), `parameters` have units,
    such as "thigh (m)", and `usual` (k, m) is the front of the default body.
    """
    (pair,) = conflicting_pairs(returns)
    x, y = returns[:, pair].T
    line = usual[usual[:, pair[0]].argsort()][:, pair]
    figure, plots = style.panels(len(parameters), COLUMNS, (3.6, 3.1), "", room=0.5)
    for axes, values, name in zip(plots, designs.T, parameters, strict=True):
        axes.plot(*line.T, "-", color="0.6", lw=1, label="default body")
        marks = axes.scatter(x, y, c=values, cmap=style.RUNS, s=SIZE)
        figure.colorbar(marks, ax=axes, label=name)
        style.lattice(axes, *(style.returned(objectives[k]) for k in pair))
        style.fit(axes, x, y)
    style.legend_outside(figure)
    return figure


def quantities_figure(front: Front, title: str = "") -> Figure:
    """Plot measured quantities against the first one, colored as returns in `front_figure`."""
    assert front.quantities is not None
    across, *others = front.quantities.T
    figure, plots = style.panels(len(others), 2, (4.0, 3.3), title, room=0.8)
    colors = style.colors_of(front.tradeoffs)
    for axes, values, name in zip(plots, others, front.quantity_names[1:], strict=True):
        style.points(axes, front, across, values, SIZE, colors)
        style.lattice(axes, front.quantity_names[0], name)
        style.fit(axes, across, values)
    style.color_key(plots[0], front.shown)
    style.legend_outside(figure)
    return figure


def returns_figure(front: Front, title: str = "") -> Figure:
    """Plot the return of each objective over the simplex of trade-offs.

    With three objectives, each is a map of the simplex. With more, each is plotted against its own
    weight, and with two, both are plotted against the weight of the first.
    """
    m, names = len(front.objectives), front.shown
    if m == 3:
        return _maps(front, title)
    colors, best = style.of_objectives(m), front.non_dominated
    columns, size = (1, (5.4, 2.6)) if m == 2 else (3, (3.4, 3.5))
    figure, plots = style.panels(m, columns, size, title)
    for k, axes in enumerate(plots):
        across = 0 if m == 2 else k
        x, y = front.tradeoffs[:, across], front.returns[:, k]
        if m == 2:
            order = x.argsort()
            axes.plot(x[order], y[order], color="0.6", lw=0.8)
        style.points(axes, front, x, y, 10, np.full(len(x), colors[k]))
        tints = colors[across], colors[k]
        style.lattice(axes, style.weight(names[across]), style.returned(names[k]), tints)
        axes.set_ylim(style.limits(y[best]))
    style.legend_outside(figure)
    return figure


def _maps(front: Front, title: str) -> Figure:
    names = front.shown
    figure = style.blank(11.0, 4.0, title)
    simplex = Triangulation(*(front.tradeoffs @ CORNERS).T)
    bar: Any = {"location": "bottom", "shrink": 0.7, "format": style.short}
    for k, axes in enumerate(figure.subplots(1, 3)):
        cells: Any = {"cmap": style.SHADES[k], "edgecolors": "face", "lw": 0.2}
        colors = axes.tripcolor(simplex, front.returns[:, k], **cells)
        for corner, name in enumerate(names):
            weight = "bold" if corner == k else "normal"
            style.note(axes, f"{name} only", CORNERS[corner], corner == 2, fontweight=weight)
        axes.plot(*CORNERS[[0, 1, 2, 0]].T, color="0.2", lw=0.8)
        axes.set(aspect="equal", xlim=(-0.15, 1.15), ylim=(-0.08, 0.95))
        axes.set_axis_off()
        bar |= {"label": style.returned(names[k]), "ticks": style.Apart()}
        figure.colorbar(colors, ax=axes, **bar)
    return figure


def hypervolume_figure(histories: Mapping[str, Any], repeated: bool, title: str = "") -> Figure:
    """Plot hypervolume against environment steps and against training seconds.

    Each `runs.progress.History` is a line with its name. Those of one training `repeated` with
    other seeds are thin lines instead, overlaid with their median and interquartile range.
    """
    figure, plots = style.panels(2, 2, (4.5, 3.7), title)
    looks = style.distinct(len(histories))
    for axes, (name, label) in zip(plots, SCALES, strict=True):
        curves = [(getattr(history, name), history.hypervolume) for history in histories.values()]
        style.lattice(axes, label)
        if not repeated:
            for run, curve, look in zip(histories, curves, looks, strict=True):
                axes.plot(*curve, **look, lw=1, ms=3.5, label=run)
            continue
        for k, curve in enumerate(curves):
            axes.plot(*curve, color="0.55", lw=0.7, label="" if k else "single run")
        steps, low, middle, high = quartile_band(curves)
        band: Any = {"color": style.INK, "alpha": 0.25, "lw": 0, "label": "interquartile range"}
        axes.fill_between(steps, low, high, **band)
        axes.plot(steps, middle, color=style.INK, lw=2, label=f"median of {len(curves)} runs")
    plots[1].sharey(plots[0])
    plots[1].tick_params(labelleft=False)
    plots[0].set_ylabel("hypervolume")
    if len(histories) > 1:
        style.legend_outside(figure)
    return figure


def quartile_band(curves: Sequence[tuple[NDArray, NDArray]]) -> NDArray:
    """Return x and quartiles (4, E) of curves (x, y), for each x of one where all have data."""
    start, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    grid = np.unique(np.concatenate([x for x, _ in curves]))
    grid = grid[(grid >= start) & (grid <= end)]
    values = [np.interp(grid, x, y) for x, y in curves]
    return np.vstack([grid, np.quantile(values, (0.25, 0.5, 0.75), axis=0)])
