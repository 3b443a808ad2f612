"""Figure of the hypervolume during training."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from .colors import INK
from .style import blank, lattice, printed

SCALES = (("env_steps", "environment steps"), ("train_seconds", "training time (s)"))


class Band(NamedTuple):
    """Quartiles over runs, at every evaluation of a run while all runs were training."""

    x: np.ndarray  # (E,)
    low: np.ndarray  # (E,) lower quartile
    middle: np.ndarray  # (E,) median
    high: np.ndarray  # (E,) upper quartile

    @classmethod
    def over(cls, curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> "Band":
        """Compute the quartiles of curves (x, y), interpolated linearly between evaluations."""
        start, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
        grid = np.unique(np.concatenate([x for x, _ in curves]))
        grid = grid[(grid >= start) & (grid <= end)]
        values = [np.interp(grid, x, y) for x, y in curves]
        return cls(grid, *np.quantile(values, (0.25, 0.5, 0.75), axis=0))


def hypervolume_figure(
    histories: Sequence[Any], title: str = "", width: float | None = None
) -> Figure:
    """Plot hypervolume against environment steps and against training seconds.

    Several runs are thin lines, overlaid with their median and interquartile range. Each is a
    `runs.progress.History`.
    """
    figure = blank(9.0, 3.7, title) if width is None else printed(width, 2, 0, title)[0]
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, label) in zip(panels, SCALES, strict=True):
        curves = [(getattr(history, name), history.hypervolume) for history in histories]
        several = len(curves) > 1
        for k, (x, y) in enumerate(curves):
            look = {"color": "0.55", "lw": 0.7} if several else {"color": INK, "marker": "o"}
            axes.plot(x, y, ms=3.5, **look, label="single run" if several and k == 0 else None)
        if several:
            band = Band.over(curves)
            style = {"color": INK, "alpha": 0.25, "lw": 0, "label": "interquartile range"}
            axes.fill_between(band.x, band.low, band.high, **style)
            axes.plot(band.x, band.middle, color=INK, lw=2, label=f"median of {len(curves)} runs")
        axes.set_xlabel(label)
        lattice(axes)
    panels[0].set_ylabel("hypervolume")
    if len(histories) > 1:
        panels[1].legend(loc="lower right")
    return figure
