"""The ground under robots that stay in place: its grid moves instead."""

import numpy as np
import viser
from numpy.typing import NDArray

SQUARE = 1.0  # m between major grid lines
DEPTH = 12.0  # m that the lines of a lane reach to the front and to the back
PLANE = {False: (236, 239, 243), True: (34, 37, 42)}  # by whether the page is dark
LINES = {False: (170, 178, 190), True: (84, 91, 102)}
FINE_LINES = {False: (214, 219, 226), True: (52, 57, 65)}
FADE = 30.0  # m


class Ground:
    """An endless plane with one moving grid, or with one per lane for robots side by side.

    Args:
        server: viser's server.
        lanes: the middle of each lane along x, in m.
        width: of a lane, in m.
        dark: whether the page is dark.
    """

    def __init__(self, server: viser.ViserServer, lanes: list[float], width: float, dark: bool):
        self._alone = len(lanes) == 1
        self._half = 0.47 * width  # leaves a gap between lanes
        lines, fine = (LINES, FINE_LINES) if self._alone else (PLANE, PLANE)
        self._plane = server.scene.add_grid(
            "/ground",
            infinite_grid=True,
            cell_size=SQUARE / 2,
            section_size=SQUARE,
            cell_color=fine[dark],
            section_color=lines[dark],
            plane_color=PLANE[dark],
            plane_opacity=1.0,
            shadow_opacity=0.3,
            fade_distance=FADE,
        )
        self._lanes = []
        if not self._alone:
            self._lanes = [
                server.scene.add_line_segments(
                    f"/lane{number}",
                    lane_lines(np.zeros(2), self._half),
                    colors=LINES[dark],
                    position=(x, 0.0, 0.002),
                )
                for number, x in enumerate(lanes)
            ]

    def move(self, centers: list[NDArray[np.float64]]) -> None:
        """Show the ground around a point (3,) of the world for each lane."""
        down = -centers[0][2]
        if self._alone:
            x, y = -np.fmod(centers[0][:2], SQUARE)
            self._plane.position = (x, y, down)
            return
        for lane, center in zip(self._lanes, centers, strict=True):
            lane.points = lane_lines(center[:2], self._half)

    def remove(self) -> None:
        """Remove the ground from the scene."""
        for part in (self._plane, *self._lanes):
            part.remove()


def lane_lines(center: NDArray[np.float64], half: float) -> NDArray[np.float32]:
    """Return the grid lines (n, 2, 3) of a lane, `half` m to both sides, around a point (2,)."""

    def places(middle: float, reach: float) -> NDArray[np.float64]:
        first = np.ceil((middle - reach) / SQUARE * 2)
        return np.arange(first, (middle + reach) / SQUARE * 2) * SQUARE / 2 - middle

    across, along = places(center[0], half), places(center[1], DEPTH)
    lines = np.zeros((len(across) + len(along) + 2, 2, 3), dtype=np.float32)
    lines[: len(across), :, 0] = across[:, None]
    lines[: len(across), :, 1] = (-DEPTH, DEPTH)
    lines[len(across) : -2, :, 0] = (-half, half)
    lines[len(across) : -2, :, 1] = along[:, None]
    lines[-2:, :, 0] = [[-half], [half]]  # the lane's borders
    lines[-2:, :, 1] = (-DEPTH, DEPTH)
    return lines
