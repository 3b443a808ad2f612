"""Pictures of a robot, rendered by MuJoCo without a window."""

import importlib
import os
import subprocess
import sys
from copy import copy
from functools import cache
from typing import Self

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from ...envs import MorlaxError
from ..looks import Looks
from .scenery import Scenery

SMALLEST, LARGEST = 64, 4096  # pixels; not every graphics driver supports more
SHADOWED = 3.0  # sizes of the robot around it in which the added light casts shadows


class Scene:
    """Renders a robot, with default looks where its model has no sky, light or floor.

    It renders a copy of the model, so that neither model nor physics change. It holds an OpenGL
    context: close it, or use it as a context manager. Width and height are in pixels.

    Raises:
        MorlaxError: the size is out of range, or OpenGL is not available.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 360):
        check_size(width, height)
        choose_opengl()
        looks = Looks.of(model)
        self._renderer = mujoco.Renderer(_rendered(model, looks, width, height), height, width)
        self._scenery = Scenery(self._renderer, model, looks)

    def draw(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> NDArray[np.uint8]:
        """Render the state in `data` as `camera` sees it: (height, width, 3) RGB."""
        self._renderer.update_scene(data, camera)
        self._scenery.add(camera)
        return self._renderer.render()

    def close(self) -> None:
        self._scenery.close()
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_size(width: int, height: int) -> None:
    """Raise MorlaxError if the size of a picture, in pixels, is out of range."""
    if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
        raise MorlaxError(
            f"cannot draw a picture of {width} x {height}: width and height must be "
            f"from {SMALLEST} to {LARGEST} pixels."
        )


def _rendered(model: mujoco.MjModel, looks: Looks, width: int, height: int) -> mujoco.MjModel:
    """Return a copy of a model whose clipping, haze and shadows suit the robot's own size."""
    model = copy(model)
    model.stat.extent = looks.size
    visual = model.vis
    size = visual.global_
    size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
    if looks.light:
        visual.map.shadowclip = max(visual.map.shadowclip, SHADOWED)
    return model


@cache
def choose_opengl() -> None:
    """Select the first OpenGL backend that works on this machine, and set MUJOCO_GL to it.

    It tries a hidden window (GLFW) if there is a display, then EGL, then OSMesa. If MUJOCO_GL is
    already set, it tries only that one.

    Raises:
        MorlaxError: no backend works.
    """
    backends = [os.environ.get("MUJOCO_GL", "")]
    if not backends[0] and sys.platform == "linux":
        screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        backends = ["glfw", "egl", "osmesa"] if screen else ["egl", "osmesa"]
    for backend in backends:
        if _works(backend):
            os.environ["MUJOCO_GL"] = backend
            importlib.reload(gl_context)  # MuJoCo read MUJOCO_GL when it was imported
            return
    raise MorlaxError(
        f"OpenGL is not available for rendering (tried: {', '.join(backends)}): install EGL "
        "(Debian: libegl1 and libopengl0) or OSMesa (libosmesa6), or set MUJOCO_GL to an installed "
        "one of glfw, egl and osmesa."
    )


def _works(backend: str) -> bool:
    # in a separate process, because PyOpenGL keeps the first platform it loads
    draw = (
        "import mujoco; model = mujoco.MjModel.from_xml_string('<mujoco/>'); "
        "mujoco.Renderer(model, 8, 8).close()"
    )
    environment = {**os.environ, "MUJOCO_GL": backend}
    done = subprocess.run([sys.executable, "-c", draw], env=environment, capture_output=True)
    return done.returncode == 0
