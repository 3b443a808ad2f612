"""Cameras of the browsers: they fit the robots once, and then belong to their users."""

import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

FIELD = 0.8  # rad, vertical
TOWARDS = np.array([0.0, -0.95, 0.22])  # from the robots to a new camera
DISTANCE = 3.8  # from a robot of size 1
HEIGHT = 0.42  # of the point that cameras look at, times the robot's size
PHONE = 576  # px of width up to which viser shows a sheet at the bottom
SETTLING = 5.0  # s in which the panels of a new page take their place beside the picture
FREE = 0.4  # share of a phone's picture that the sheet leaves free


def set_initial(server: viser.ViserServer, size: float) -> None:
    """Set where new browsers, and "Reset View", put the camera for robots of a size in m."""
    camera = server.initial_camera
    camera.fov = FIELD
    camera.look_at = (0.0, 0.0, HEIGHT * size)
    camera.position = tuple(camera.look_at + DISTANCE * size * _unit(TOWARDS))


def fit(client: viser.ClientHandle, size: float, width: float, keep_direction: bool) -> None:
    """Move one browser's camera so that robots fit into the picture.

    Args:
        client: the browser.
        size: of the largest robot, in m.
        width: of all robots side by side, in m.
        keep_direction: whether the user keeps the direction they look from.
    """
    camera = client.camera
    wide, high = max(camera.image_width, 1), max(camera.image_height, 1)
    direction = _unit(camera.position - camera.look_at) if keep_direction else _unit(TOWARDS)
    phone = wide <= PHONE
    across = 2 * np.tan(FIELD / 2) * wide / high  # visible width at a distance of 1 m
    distance = max(DISTANCE * size, 1.15 * width / across)
    target = np.array([0.0, 0.0, HEIGHT * size])
    if phone:  # the robots belong into the upper part, which the sheet leaves free
        target[2] -= (1 - FREE) * distance * np.tan(FIELD / 2)
    with suppress(ValueError):  # viser cannot move a camera that looks at its own position
        camera.position = target + distance * direction
        camera.look_at = target


def on_first_resize(client: viser.ClientHandle, act: Callable[[], None]) -> None:
    """Call `act` when the picture of a new browser changes its size, within `SETTLING` seconds."""
    camera, until = client.camera, time.monotonic() + SETTLING
    size = camera.image_width, camera.image_height

    @camera.on_update
    async def _(_: viser.CameraHandle) -> None:
        nonlocal size
        now = camera.image_width, camera.image_height
        if now != size and time.monotonic() < until:
            size = now
            act()


def _unit(vector: ArrayLike) -> NDArray[np.float64]:
    vector = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else _unit(TOWARDS)
