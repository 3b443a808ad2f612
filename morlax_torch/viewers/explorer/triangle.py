"""The trade-offs of three objectives, as a triangle with a point that users can drag."""

import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...colors import mix, of_objectives
from . import svg
from .svg import GRAY, Box

ROOM = 22  # beside and below the triangle, for names
SHADES = 20  # colored dots along an edge


class Triangle:
    """An equilateral triangle with one corner per objective.

    Args:
        objectives: three names.
        box: the triangle's area with its labels, in units of the drawing.
    """

    def __init__(self, objectives: Sequence[str], box: Box):
        self._objectives = tuple(objectives)
        tall = min((box.width - 2 * ROOM) * 3**0.5 / 2, box.height - 2 * ROOM)
        middle, bottom, half = box.left + box.width / 2, box.top + box.height - ROOM, tall / 3**0.5
        self._corners = np.array(
            [[middle, bottom - tall], [middle - half, bottom], [middle + half, bottom]]
        )

    def place(self, weights: ArrayLike) -> np.ndarray:
        """Return the position (2,) of a trade-off (3,) in the drawing."""
        return np.asarray(weights) @ self._corners

    def html(self) -> str:
        """Return the static part of the triangle."""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in self._corners)
        parts = [svg.element("polygon", points=points, fill="transparent", stroke=GRAY)]
        for i in range(SHADES + 1):
            for j in range(SHADES + 1 - i):
                weights = np.array([i, j, SHADES - i - j]) / SHADES
                parts.append(svg.circle(self.place(weights), 2, mix(weights), opacity=0.5))
        names = zip(self._objectives, self._corners, of_objectives(3), (-11, 18, 18), strict=True)
        for name, (x, y), color, below in names:
            parts.append(svg.text(name, x, y + below, color, font_weight=600))
        # this matrix times weights is (x, y, 1); the browser applies its inverse
        back = np.linalg.inv(np.vstack([self._corners.T, np.ones(3)]))
        return svg.element(
            "g", "".join(parts), data_cell="simplex", data_map=json.dumps(back.tolist())
        )
