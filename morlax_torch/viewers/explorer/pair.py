"""The returns of two objectives against each other, as a plot that users can pick from."""

from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from ...colors import mix
from ...evaluation.front import Front
from . import svg
from .svg import GRAY, INK, Box
from .weights import show

LEFT, TOP, RIGHT, BOTTOM = 46, 8, 10, 32  # margins of the axes, for tick labels and names
FAINT = {"stroke": INK, "stroke_opacity": 0.12}  # grid lines


class PairPlot:
    """All evaluated returns of a front.

    Non-dominated points are colored by their trade-off and can be picked; dominated ones are gray.

    Args:
        front: the evaluated trade-offs.
        x: index of the objective on the x axis.
        y: index of the objective on the y axis.
        box: the plot's area, in units of the drawing.
    """

    def __init__(self, front: Front, x: int, y: int, box: Box):
        self._front, self._objectives, self._outer = front, (x, y), box
        width, height = box.width - LEFT - RIGHT, box.height - TOP - BOTTOM
        self._axes = Box(box.left + LEFT, box.top + TOP, width, height)
        returns = front.returns[:, [x, y]]
        low, high = returns.min(0), returns.max(0)
        margin = np.maximum(0.06 * (high - low), 1e-6 + 1e-6 * np.abs(high))
        self._low, self._high = low - margin, high + margin
        self.places = self._place(returns)  # (K, 2) in units of the drawing

    def html(self) -> str:
        """Return the static part of the plot."""
        front, best = self._front, self._front.non_dominated
        x, y, width, height = self._outer
        parts = [svg.element("rect", x=x, y=y, width=width, height=height, fill="transparent")]
        parts += self._scales()
        parts += [svg.circle(place, 1.5, GRAY) for place in self.places[~best]]
        policies = zip(self.places[best], front.tradeoffs[best], front.returns[best], strict=True)
        for place, weights, returns in policies:
            tip = svg.element("title", describe(front.objectives, weights, returns))
            parts.append(svg.circle(place, 2.5, mix(weights), tip, data_w=show(weights)))
        cell = "{} {}".format(*self._objectives)
        return svg.element("g", "".join(parts), data_cell=cell)

    def level(self, objective: int, value: float) -> str:
        """Return a line where an objective has a value; empty if this plot does not show it."""
        if objective not in self._objectives:
            return ""
        left, top, width, height = self._axes
        x, y = self._place(np.full(2, value))
        if objective == self._objectives[0]:
            ends = {"x1": x, "x2": x, "y1": top, "y2": top + height}
        else:
            ends = {"x1": left, "x2": left + width, "y1": y, "y2": y}
        dashes = {"stroke": INK, "stroke_width": 1.2, "stroke_dasharray": "4 3"}
        return svg.element("line", **ends, **dashes, data_level=value)

    def _place(self, returns: np.ndarray) -> np.ndarray:
        share = (returns - self._low) / (self._high - self._low)
        axes = self._axes
        return [axes.left, axes.top + axes.height] + share * [axes.width, -axes.height]

    def _scales(self) -> list[str]:
        """Draw grid lines, tick labels and axis names."""
        left, top, width, height = self._axes
        right, bottom = left + width, top + height
        locator = MaxNLocator(4 if width > 200 else 2)
        parts = []
        for x in locator.tick_values(self._low[0], self._high[0]):
            at = self._place(np.array([x, self._low[1]]))[0]
            if left <= at <= right:
                parts.append(svg.element("line", x1=at, x2=at, y1=top, y2=bottom, **FAINT))
                parts.append(svg.text(_short(x), at, bottom + 12, INK))
        for y in locator.tick_values(self._low[1], self._high[1]):
            at = self._place(np.array([self._low[0], y]))[1]
            if top <= at <= bottom:
                parts.append(svg.element("line", x1=left, x2=right, y1=at, y2=at, **FAINT))
                parts.append(svg.text(_short(y), left - 4, at + 3, INK, "end"))
        first, second = (f"{self._front.objectives[i]} (return)" for i in self._objectives)
        turned = f"translate({left - 37:g} {top + height / 2:g}) rotate(-90)"
        parts.append(svg.text(first, left + width / 2, bottom + 26, INK))
        parts.append(svg.text(second, 0, 0, INK, transform=turned))
        return parts


def describe(objectives: Sequence[str], weights: ArrayLike, returns: ArrayLike) -> str:
    """Return the lines of a tooltip: the trade-off and the returns of a policy, escaped."""
    lines = [
        f"{name}: weight {weight:.2f}, return {value:,.0f}"
        for name, weight, value in zip(
            objectives, np.asarray(weights), np.asarray(returns), strict=True
        )
    ]
    return escape("\n".join(lines))


def _short(value: float) -> str:
    """Format a tick label: 2500 is 2.5k."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"
