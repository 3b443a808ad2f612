"""A film of training: the growing front, its hypervolume, and robots of the trained policies."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from ...envs import MorlaxError
from ...evaluation import style
from ...evaluation.front import Front
from ...evaluation.pareto import conflicting_pairs, non_dominated
from ...host.phases import phase
from ...networks.policy import Policy
from ...runs.progress import Moment
from . import panels
from .recording import Film

HELD = 0.1  # share of a film that shows the end of training
DPI = 100
HALVES = {"left": 0.075, "right": 0.985, "wspace": 0.22, "bottom": 0.15, "top": 0.95}
SIZES, GRAY = (4, 14), (0.75, 0.75, 0.75)  # square points; of dominated policies, and others


class Growth(Film):
    """Plots of a run's training, beside robots of its policies under some trade-offs.

    Each evaluation whose front was kept lasts equally long; between two, points move straight
    ahead. `record` describes the arguments. Raises MorlaxError if there are no two evaluations.
    """

    def __init__(
        self,
        policy: Policy,
        moments: Sequence[Moment],
        tradeoffs: Sequence[Any],
        width: int = 480,
        height: int = 360,
        seed: int = 0,
    ):
        if len(moments) < 2:
            raise MorlaxError(
                "the run has not kept two fronts of its training, so no growth can be filmed: only "
                "runs that this version trained do."
            )
        self._moments, self._fronts = moments, [Front.load(moment.file) for moment in moments]
        last, m = self._fronts[-1], len(policy.objectives)
        (self._pair,) = conflicting_pairs(last.returns[last.non_dominated])
        ends = np.eye(m)[list(self._pair)].tolist()
        super().__init__(policy, tradeoffs or ends, width, height, seed)
        for take in self._takes:
            take.note = "after training"
        self._canvas = FigureCanvasAgg(style.blank(2 * width / DPI, height / DPI, ""))
        self._canvas.figure.set_dpi(DPI)
        self._canvas.figure.set_layout_engine("none")
        self._map, self._curve = self._canvas.figure.subplots(1, 2, gridspec_kw=HALVES)
        self._draw_axes(last.shown)

    def _draw_axes(self, names: Sequence[str]) -> None:
        """Draw what stays, and prepare what moves."""
        colors = style.of_objectives(len(names))
        (x, across), (y, up) = ((style.returned(names[k]), colors[k]) for k in self._pair)
        style.lattice(self._map, x, y, (across, up))
        best = np.concatenate([front.returns[front.non_dominated] for front in self._fronts])
        xlim, ylim = map(style.limits, best[:, self._pair].T)
        self._map.set(xlim=xlim, ylim=ylim)
        style.lattice(self._curve, "training time (s)", "hypervolume")
        self._curve.yaxis.set_major_formatter(style.short)
        self._numbers = np.array([moment[:3] for moment in self._moments])  # (E, 3)
        _, seconds, volume = self._numbers.max(0) * 1.04
        self._curve.set(xlim=(0, seconds or 1), ylim=(0, volume or 1))
        self._points = self._map.scatter([], [], animated=True)
        look: Any = {"color": style.INK, "marker": "o", "animated": True}
        (self._line,) = self._curve.plot([], [], ms=3, lw=1.5, **look)
        (self._head,) = self._curve.plot([], [], ms=8, **look)
        corner: Any = {"transform": self._curve.transAxes, "ha": "right", "va": "bottom"}
        self._told = self._curve.text(0.97, 0.05, "", linespacing=1.5, animated=True, **corner)

    def frames(self, seconds: float = 30.0, stride: int = 1) -> Iterator[NDArray[np.uint8]]:
        takes, steps = self._takes, self.steps(seconds)
        for take in takes:
            take.reset()
        self._canvas.draw()
        self._still, self._passed = self._drawn(), 0  # with so many earlier fronts
        with self._scenes() as scenes:
            for step in range(0, steps + 1, stride):
                phase("filming", step / steps)
                for take in takes:
                    for _ in range(stride if step else 0):
                        if take.failed or take.player.over:
                            take.reset()
                        take.step()
                farthest = max(take.distance for take in takes)
                pairs = zip(takes, scenes, strict=True)
                robots = [take.panel(scene, farthest) for take, scene in pairs]
                place = min(1.0, step / steps / (1 - HELD)) * (len(self._fronts) - 1)
                shown = [*self._plots(place, *robots[0].size), *robots]
                yield panels.side_by_side(shown, max(3, -(-len(shown) // 2)))

    def _drawn(self) -> Any:
        """Return what the canvas shows, to be restored."""
        return self._canvas.copy_from_bbox(self._canvas.figure.bbox)

    def _plots(self, place: float, width: int, height: int) -> list[Image.Image]:
        """Draw both plots at a place among the evaluations, such as 2.5, each of this size."""
        index, canvas = int(place), self._canvas
        canvas.restore_region(self._still)
        for front in self._fronts[self._passed : index]:
            returns = front.returns[front.non_dominated][:, self._pair]
            form = "-" if len(front.objectives) == 2 else "."
            look: Any = {"color": "0.85", "lw": 0.8, "ms": 2, "animated": True}
            (earlier,) = self._map.plot(*returns[returns[:, 0].argsort()].T, form, **look)
            self._map.draw_artist(earlier)
            self._still = self._drawn()
        self._passed = index
        following = self._fronts[min(index + 1, len(self._fronts) - 1)]
        front, returns = self._fronts[index], self._fronts[index].returns
        if np.array_equal(front.tradeoffs, following.tradeoffs):
            returns = returns + (place - index) * (following.returns - returns)
        best, colors = non_dominated(returns), style.colors_of(front.tradeoffs)
        order, colors = best.argsort(), np.where(best[:, None], colors, GRAY)
        self._points.set(offsets=returns[order][:, self._pair], facecolors=colors[order])
        self._points.set_sizes(np.choose(best[order], SIZES))
        number = np.arange(len(self._numbers))
        steps, seconds, volume = (np.interp(place, number, column) for column in self._numbers.T)
        line = [*self._numbers[number <= place, 1:], (seconds, volume)]
        self._line.set_data(*np.transpose(line))
        self._head.set_data([seconds], [volume])
        steps, reached = (style.short(float(f"{value:.3g}")) for value in (steps, volume))
        self._told.set_text(f"{seconds:,.0f} s of training\n{steps} steps\n{reached}")
        self._map.draw_artist(self._points)
        for artist in (self._line, self._head, self._told):
            self._curve.draw_artist(artist)
        both = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        both = both.resize((2 * width, height))
        return [both.crop((left, 0, left + width, height)) for left in (0, width)]
