"""Pictures of a robot, drawn by MuJoCo without a window."""

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

CAMERA = "track"  # of our own robots
SMALLEST, LARGEST = 64, 4096  # pixels; graphics drivers differ on more


class Scene:
    """Draws a robot from its camera `track`, or from one that follows its first body.

    It holds an OpenGL context: close it, or use it as a context manager.

    Args:
        model: `player.model`, or the like.
        width: of the pictures, in pixels.
        height: likewise.

    Raises:
        MorlaxError: the size is none, or OpenGL is not to be had.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 360):
        if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
            raise MorlaxError(
                f"a picture of {width} x {height} cannot be drawn: width and height must be "
                f"from {SMALLEST} to {LARGEST} pixels."
            )
        choose_opengl()
        size = model.vis.global_
        size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
        self._renderer = mujoco.Renderer(model, height, width)
        self._camera = _camera(model)

    def draw(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """(height, width, 3) RGB of the robot as it stands in `data`."""
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
        camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 1
        camera.distance, camera.azimuth, camera.elevation = 2 * model.stat.extent, 90, -15
    return camera


@cache
def choose_opengl() -> None:
    """Let MuJoCo draw in the first way that works here, and note it in MUJOCO_GL.

    Where there is a screen that is a hidden window, then EGL, then OSMesa. A MUJOCO_GL that is
    set already has the only say.

    Raises:
        MorlaxError: none works.
    """
    ways = [os.environ.get("MUJOCO_GL", "")]
    if not ways[0] and sys.platform == "linux":
        screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ways = ["glfw", "egl", "osmesa"] if screen else ["egl", "osmesa"]
    for way in ways:
        if _works(way):
            os.environ["MUJOCO_GL"] = way
            importlib.reload(gl_context)  # which read MUJOCO_GL when MuJoCo was imported
            return
    raise MorlaxError(
        f"there is no OpenGL to draw with (tried: {', '.join(ways)}): install EGL (Debian: "
        "libegl1 and libopengl0) or OSMesa (libosmesa6), or set MUJOCO_GL to what there is, of "
        "glfw, egl, osmesa."
    )


def _works(way: str) -> bool:
    # In a process of its own, because PyOpenGL keeps to the first platform it is asked for.
    draw = (
        "import mujoco; model = mujoco.MjModel.from_xml_string('<mujoco/>'); "
        "mujoco.Renderer(model, 8, 8).close()"
    )
    environment = {**os.environ, "MUJOCO_GL": way}
    done = subprocess.run([sys.executable, "-c", draw], env=environment, capture_output=True)
    return done.returncode == 0
