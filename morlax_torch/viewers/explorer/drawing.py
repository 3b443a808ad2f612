"""The front and the trade-off triangle as one SVG drawing that users can pick from.

The drawing is sent once. The marks of the current trade-off are a second SVG on top, so that the
browser redraws little while a user drags.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from ...colors import mix
from ...evaluation.front import Front
from . import picking, svg
from .pair import PairPlot
from .svg import INK, Box
from .triangle import Triangle
from .weights import Weights, show

WIDTH = 320.0
TALL, LOW = 205.0, 150.0  # height of a single plot, and of two plots side by side


class Drawing:
    """The returns of two objectives; with three objectives, the triangle comes first.

    Args:
        objectives: their names.
        front: the evaluated front; None: draw no plot.
        pair: indices of the objectives on the x and y axes of the plot.
    """

    def __init__(self, objectives: Sequence[str], front: Front | None, pair: tuple[int, int]):
        number = (len(objectives) == 3) + (front is not None)
        wide, self._height = (WIDTH / 2, LOW) if number == 2 else (WIDTH, TALL * number)
        boxes = [Box(i * wide, 0.0, wide, self._height) for i in range(number)]
        self._triangle = Triangle(objectives, boxes.pop(0)) if len(objectives) == 3 else None
        self._plot = PairPlot(front, *pair, boxes.pop()) if front is not None else None

    def html(self) -> str:
        """Return the static part of the drawing, to send once."""
        shapes = [shape.html() for shape in (self._triangle, self._plot) if shape is not None]
        style = "touch-action:none;user-select:none;cursor:pointer"
        return self._svg("".join(shapes), style, **picking.handlers())

    def marks(
        self,
        weights: Weights,
        nearest: int | None,
        others: Sequence[int] = (),
        levels: Mapping[int, float] | None = None,
    ) -> str:
        """Return the overlay that marks the current trade-off.

        Args:
            weights: the current trade-off, marked in the triangle.
            nearest: index of the nearest evaluated trade-off, marked in the plot; None without a
                front.
            others: indices of further evaluated trade-offs, of other robots.
            levels: required returns by index of the objective, drawn as lines.
        """
        line: dict[str, Any] = {"stroke": INK, "stroke_width": 2}
        parts = []
        if self._triangle is not None:
            parts.append(svg.circle(self._triangle.place(weights), 6, mix(weights), **line))
        if self._plot is not None:
            parts += [self._plot.level(i, value) for i, value in (levels or {}).items()]
            faint = {**line, "stroke_width": 1.2, "stroke_opacity": 0.6}
            parts += [svg.circle(self._plot.places[i], 5, "none", **faint) for i in others]
            if nearest is not None:
                place = self._plot.places[nearest]
                parts.append(svg.circle(place, 6, "none", data_here="", **line))
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
