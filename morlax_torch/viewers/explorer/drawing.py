"""The front and the trade-off triangle as one SVG drawing that users can pick from.

The drawing is sent once. The marks of the current trade-off are a second SVG on top, so that the
browser redraws little while a user drags.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

from ...colors import mix
from ...evaluation.front import Front
from . import picking, svg
from .pair import PairPlot
from .svg import Box
from .triangle import Triangle
from .weights import Weights, show

WIDTH = 320.0
TALL, LOW = 225.0, 150.0  # height of a single plot, and of each of several plots


class Drawing:
    """A plot for every pair of objectives; with three objectives, the triangle comes first.

    Args:
        objectives: their names.
        front: the evaluated front, None if there is none: then there are no plots.
    """

    def __init__(self, objectives: Sequence[str], front: Front | None):
        m = len(objectives)
        pairs = list(combinations(range(m), 2)) if front is not None else []
        number = len(pairs) + (m == 3)
        wide, high = (WIDTH, TALL) if number == 1 else (WIDTH / 2, LOW)
        boxes = [Box(i % 2 * wide, i // 2 * high, wide, high) for i in range(number)]
        self._height = -(-number // 2) * high
        self._triangle = Triangle(objectives, boxes.pop(0)) if m == 3 else None
        self._plots = [
            PairPlot(front, *pair, box)
            for pair, box in zip(pairs, boxes, strict=True)
            if front is not None
        ]

    def html(self) -> str:
        """Return the static part of the drawing, to send once."""
        shapes = [self._triangle, *self._plots] if self._triangle else self._plots
        style = "touch-action:none;user-select:none;cursor:pointer"
        return self._svg("".join(shape.html() for shape in shapes), style, **picking.handlers())

    def marks(self, weights: Weights, nearest: int | None) -> str:
        """Return the overlay that marks the current trade-off.

        Args:
            weights: the current trade-off, marked in the triangle.
            nearest: index of the nearest evaluated trade-off, marked in the plots; None without a
                front.
        """
        line: dict[str, Any] = {"stroke": "#111", "stroke_width": 2}
        parts = []
        if self._triangle is not None:
            parts.append(svg.circle(self._triangle.place(weights), 6, mix(weights), **line))
        if nearest is not None:
            for plot in self._plots:
                parts.append(svg.circle(plot.places[nearest], 6, "none", data_here="", **line))
        style = "position:absolute;left:0;bottom:0;pointer-events:none"
        over = self._svg("".join(parts), style, data_tradeoff=show(weights))
        return svg.element("div", over, style="position:relative;height:0")

    def _svg(self, content: str, style: str, **attributes: Any) -> str:
        return svg.element(
            "svg",
            content,
            viewBox=f"0 0 {WIDTH:g} {self._height:g}",
            style=f"display:{'block' if self._height else 'none'};width:100%;{style}",
            font_size=10,
            **attributes,
        )
