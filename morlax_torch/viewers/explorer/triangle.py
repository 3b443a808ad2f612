"""All trade-offs of three objectives, as a triangle in which a point can be dragged."""

import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import svg
from .colours import GREY, mix, of_objectives
from .svg import Box

ROOM = 22  # beside and below the triangle, for names
SHADES = 20  # coloured dots along an edge


class Triangle:
    """A triangle with equal sides, in a box of a drawing; a corner for each objective."""

    def __init__(self, objectives: Sequence[str], box: Box):
        self._objectives = tuple(objectives)
        tall = min((box.width - 2 * ROOM) * 3**0.5 / 2, box.height - 2 * ROOM)
        middle, bottom, half = box.left + box.width / 2, box.top + box.height - ROOM, tall / 3**0.5
        self._corners = np.array(
            [[middle, bottom - tall], [middle - half, bottom], [middle + half, bottom]]
        )

    def place(self, weights: ArrayLike) -> np.ndarray:
        """(2,) where a trade-off lies."""
        return np.asarray(weights) @ self._corners

    def html(self) -> str:
        """What does not change."""
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in self._corners)
        parts = [svg.element("polygon", points=points, fill="#f4f6f8", stroke=GREY)]
        for i in range(SHADES + 1):
            for j in range(SHADES + 1 - i):
                weights = np.array([i, j, SHADES - i - j]) / SHADES
                parts.append(svg.circle(self.place(weights), 2, mix(weights), opacity=0.5))
        names = zip(self._objectives, self._corners, of_objectives(3), (-6, 13, 13), strict=True)
        for name, (x, y), colour, below in names:
            parts.append(svg.text(name, x, y + below, colour, font_weight=600))
        # (x, y, 1) of a place are these corners times its weights; the browser goes back
        back = np.linalg.inv(np.vstack([self._corners.T, np.ones(3)]))
        return svg.element(
            "g", "".join(parts), data_cell="simplex", data_map=json.dumps(back.tolist())
        )
