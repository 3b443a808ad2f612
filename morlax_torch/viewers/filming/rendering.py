"""Pictures of a robot, rendered by MuJoCo without a window."""

import importlib
import os
import subprocess
import sys
from functools import cache
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from ...envs import MorlaxError
from ..following import followed_body

CAMERA = "track"  # name of the camera in the built-in robots
SMALLEST, LARGEST = 64, 4096  # pixels; not every graphics driver supports more


class Scene:
    """Renders a robot from its camera `track`, or from a camera that follows it.

    It holds an OpenGL context: close it, or use it as a context manager.

    Args:
        model: such as `player.model`; its offscreen buffer is enlarged if needed.
        width: of the pictures, in pixels.
        height: of the pictures, in pixels.

    Raises:
        MorlaxError: the size is out of range, or OpenGL is not available.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 360):
        if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
            raise MorlaxError(
                f"cannot draw a picture of {width} x {height}: width and height must be "
                f"from {SMALLEST} to {LARGEST} pixels."
            )
        choose_opengl()
        size = model.vis.global_
        size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
        self._renderer = mujoco.Renderer(model, height, width)
        self._camera = _camera(model)

    def draw(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Render the state in `data`: (height, width, 3) RGB."""
        self._renderer.update_scene(data, self._camera)
        return self._renderer.render()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _camera(model: mujoco.MjModel) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.fixedcamid = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if camera.fixedcamid >= 0:
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    else:
        camera.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        camera.trackbodyid = followed_body(model)
        camera.distance, camera.azimuth, camera.elevation = 2 * model.stat.extent, 90, -15
    return camera


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
