"""A film of training: the growing front, its hypervolume, and robots of the trained policies."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from ...envs import MorlaxError
from ...evaluation import style
from ...evaluation.figures import label_axes
from ...evaluation.front import Front
from ...evaluation.pareto import conflicting_pairs, non_dominated
from ...networks.policy import Policy
from ...runs.progress import Kept
from . import panels
from .recording import Film

HELD = 0.1  # share of a film that shows the end of training
INCHES = 4.8  # width of a plot
HALVES = {"left": 0.075, "right": 0.985, "wspace": 0.22, "bottom": 0.15, "top": 0.95}
EARLIER: Any = {"animated": True, "color": "0.85", "lw": 0.8, "ms": 2}
LINE: Any = {"animated": True, "color": style.INK, "marker": "o", "ms": 3}
CORNER: Any = {"animated": True, "ha": "right", "va": "bottom", "linespacing": 1.5}


class Growth(Film):
    """Plots of a run's training, beside robots of its policies under some trade-offs.

    Each evaluation whose front was kept lasts equally long; between two, points move straight
    ahead. Without trade-offs, there is a robot for each plotted objective alone.
    """

    endless = True

    def __init__(
        self, policy: Policy, kept: Kept, tradeoffs: Sequence, width: int, height: int, seed: int
    ):
        if len(kept) < 2:
            raise MorlaxError(
                "a film of training needs the fronts of two evaluations, but the run has kept "
                f"{len(kept)}: train longer, or lower evaluation.every."
            )
        self._fronts = [Front.load(file) for file in kept]
        self._numbers = np.array([*kept.values()])  # (E, 3): steps, seconds, hypervolume
        best = [front.returns[front.non_dominated] for front in self._fronts]
        (self._pair,) = conflicting_pairs(best[-1])
        names, m = self._fronts[-1].shown, len(policy.objectives)
        alone = np.eye(m)[list(self._pair)].tolist()
        super().__init__(policy, tradeoffs or alone, width, height, seed)
        for take in self._takes:
            take.note = "after training"
        figure = style.blank(2 * INCHES, INCHES * height / width, "")
        figure.set(dpi=width / INCHES, layout_engine="none")
        self._canvas = FigureCanvasAgg(figure)
        self._map, self._curve = figure.subplots(1, 2, gridspec_kw=HALVES)
        label_axes(self._map, names, self._pair)
        xlim, ylim = map(style.limits, np.concatenate(best)[:, self._pair].T)
        self._map.set(xlim=xlim, ylim=ylim)
        style.lattice(self._curve, "training time (s)", "hypervolume")
        _, seconds, volume = 1.04 * self._numbers.max(0)
        self._curve.set(xlim=(0, seconds or 1), ylim=(0, volume or 1))
        self._curve.yaxis.set_major_formatter(style.short)
        self._points = self._map.scatter([], [], s=14, animated=True)
        form = "-" if m == 2 else "."
        lines = (points[points[:, 0].argsort()][:, self._pair].T for points in best)
        self._earlier = [self._map.plot(*line, form, **EARLIER)[0] for line in lines]
        (self._line,) = self._curve.plot([], [], **LINE)
        corner = self._curve.transAxes
        self._told = self._curve.text(0.97, 0.05, "", transform=corner, **CORNER)
        self._canvas.draw()
        self._empty: Any = self._canvas.copy_from_bbox(figure.bbox)

    def _arranged(self, robots: list[Image.Image], share: float) -> NDArray[np.uint8]:
        """Draw the evaluations that are over by a share of the film, and what moves on."""
        width, height = robots[0].size
        moment = min(1.0, share / (1 - HELD)) * (len(self._fronts) - 1)  # such as 2.5
        self._canvas.restore_region(self._empty)
        for line in self._earlier[: int(moment)]:
            self._map.draw_artist(line)
        before, after = self._fronts[int(moment)], self._fronts[int(np.ceil(moment))]
        returns, colors = before.returns, style.colors_of(before.tradeoffs)
        if np.array_equal(before.tradeoffs, after.tradeoffs):
            returns = returns + (moment % 1) * (after.returns - returns)
        best = non_dominated(returns)
        self._points.set(offsets=returns[best][:, self._pair], facecolors=colors[best])
        self._map.draw_artist(self._points)
        evaluation = np.arange(len(self._numbers))
        now = [np.interp(moment, evaluation, column) for column in self._numbers.T]
        self._line.set_data(*np.vstack([self._numbers[evaluation < moment], now]).T[1:])
        steps, volume = (style.short(float(f"{now[k]:.3g}")) for k in (0, 2))
        self._told.set_text(f"{now[1]:,.0f} s of training\n{steps} steps\n{volume}")
        for artist in (self._line, self._told):
            self._curve.draw_artist(artist)
        both = Image.fromarray(np.asarray(self._canvas.buffer_rgba())[..., :3])
        both = both.resize((2 * width, height))
        plots = [both.crop((left, 0, left + width, height)) for left in (0, width)]
        return panels.side_by_side([*plots, *robots], max(3, 1 + -(-len(robots) // 2)))
