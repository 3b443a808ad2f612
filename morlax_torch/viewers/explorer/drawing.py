"""The front, and the triangle of trade-offs, as one drawing that a pointer can pick from.

It is an SVG that is sent once; the marks of the current trade-off are a second one laid over it,
so that a browser has little to redraw while somebody drags.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

from ...evaluation.front import Front
from . import picking, svg
from .colours import mix
from .pair import PairPlot
from .svg import Box
from .triangle import Triangle
from .weights import Weights, show

WIDTH = 320.0
TALL, LOW = 225.0, 150.0  # heights of a plot that stands alone, and of one among others


class Drawing:
    """A plot for every pair of objectives and, for three objectives, the triangle before them.

    Without a front there are no plots.
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
        """What is sent once."""
        shapes = [self._triangle, *self._plots] if self._triangle else self._plots
        style = "touch-action:none;user-select:none;cursor:pointer"
        return self._svg("".join(shape.html() for shape in shapes), style, **picking.handlers())

    def marks(self, weights: Weights, nearest: int | None) -> str:
        """What is laid over it: the trade-off, and the evaluated one nearest to it by index."""
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
