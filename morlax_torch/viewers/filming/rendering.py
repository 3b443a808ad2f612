"""Pictures of a robot, rendered by MuJoCo without a window."""

import importlib
import os
import subprocess
import sys
from contextlib import AbstractContextManager
from copy import copy
from functools import cache
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtGeom
from mujoco.rendering.classic import gl_context
from numpy.typing import ArrayLike, NDArray

from ...envs import MorlaxError
from ...envs.worlds.trees import forwarded
from ..camera import GRAY, reach, shown_geoms
from ..window import has_display

SMALLEST, LARGEST = 64, 4096  # pixels; not every graphics driver supports more
DIM = 0.8  # ambient plus diffuse; headlights dimmer than this do not light a scene
AMBIENT, SUN = 0.4, np.array([0.25, 0.35, -1.0])  # of an added light; the direction of its rays
SKY, FLOOR, LINE = (0.62, 0.72, 0.84, 1.0), (0.87, 0.90, 0.94, 1.0), (0.6, 0.64, 0.7, 1.0)
GHOST = 0.35, 0.65, 0.45, 0.4
TRIAL = (
    "import mujoco; model = mujoco.MjModel.from_xml_string('<mujoco/>'); "
    "mujoco.Renderer(model, 8, 8).close()"
)
LINES, FAR = 24, 10.0  # lines of an added grid to each side; sizes of the robot to an added sky


class Scene(AbstractContextManager["Scene"]):
    """Renders a copy of a robot's model, which gets a sky, a light or a floor if it has none.

    It holds an OpenGL context: close it, or use it as a context manager. Raises MorlaxError if the
    size in pixels is out of range, or OpenGL is not available.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 480, height: int = 360):
        check_size(width, height)
        choose_opengl()
        model, data = copy(model), forwarded(model)
        low, self._size = reach(model, data)
        model.stat.extent = self._size  # clipping, haze and shadows suit the robot's own size
        visual, head = model.vis, model.vis.headlight
        size = visual.global_
        size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
        bright = head.active and np.max(head.ambient) + np.max(head.diffuse) >= DIM
        self._sun = not bright and not model.light_active.any()
        if self._sun:
            head.active, head.ambient[:], head.diffuse[:] = 1, AMBIENT, 0.0
            visual.map.shadowclip = max(visual.map.shadowclip, 2.0)
        self._sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX not in model.tex_type
        planes = (model.geom_type == mjtGeom.mjGEOM_PLANE) & (data.geom_xmat[:, 8] > 0.95)
        wide = model.geom_aabb[:, 3:5].min(1) > self._size / 2
        still = (model.body_weldid[model.geom_bodyid] == 0) & shown_geoms(model)
        floors = still & (planes | wide | (model.geom_type == mjtGeom.mjGEOM_HFIELD))
        plain = floors & planes & (model.geom_matid < 0)
        model.geom_rgba[plain & (model.geom_rgba == GRAY).all(1)] = FLOOR
        self._ground = None if floors.any() else low - 0.01 * self._size  # to be added, in m
        self._grid = data.geom_xpos[plain, 2].max() if plain.any() else self._ground  # of lines
        self._renderer = mujoco.Renderer(model, height, width)

    def draw(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, ghost: mujoco.MjData | None = None
    ) -> NDArray[np.uint8]:
        """Render the state in `data` as `camera` sees it: (height, width, 3) RGB.

        A ghost is a translucent robot in another state.
        """
        self._renderer.update_scene(data, camera)
        scene, size = self._renderer.scene, self._size
        if ghost is not None:
            view, hand, first = mujoco.MjvOption(), mujoco.MjvPerturb(), scene.ngeom
            moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
            mujoco.mjv_addGeoms(self._renderer.model, ghost, view, hand, moving, scene)
            for geom in scene.geoms[first : scene.ngeom]:
                geom.rgba[:], geom.matid = GHOST, -1
        step = 2.0 ** round(np.log2(size / 4))  # m between lines
        x, y, _ = np.round(camera.lookat / step) * step  # lines stay in place
        if self._ground is not None:
            half = 20 * size
            self._add(mjtGeom.mjGEOM_PLANE, (half, half, 1), (x, y, self._ground), FLOOR)
        if self._grid is not None:
            z, half, thin, flat = self._grid, LINES * step, 0.005 * size, 5e-4 * size
            for at in step * np.arange(-LINES, LINES + 1):
                self._add(mjtGeom.mjGEOM_BOX, (thin, half, flat), (x + at, y, z), LINE)
                self._add(mjtGeom.mjGEOM_BOX, (half, thin, flat), (x, y + at, z), LINE)
        if self._sun:
            light = scene.lights[scene.nlight]
            scene.nlight += 1
            light.type, light.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, 1
            light.id, light.headlight, light.texid, light.attenuation[:] = -1, 0, -1, (1, 0, 0)
            light.ambient[:], light.diffuse[:], light.specular[:] = 0.0, 0.5, 0.3
            light.pos[:], light.dir[:] = camera.lookat - 2 * size * SUN, SUN
        if self._sky:  # a wall far behind the robot
            eye, half = scene.camera[0], FAR * size
            axes = np.stack([np.cross(eye.forward, eye.up), eye.up, -eye.forward], 1)
            middle = eye.pos + half * eye.forward
            wall = self._add(mjtGeom.mjGEOM_BOX, (half, half, 0.1), middle, SKY)
            wall.mat[:], wall.emission = axes, 0.5
        return self._renderer.render()

    def _add(self, kind: mjtGeom, size: ArrayLike, position: ArrayLike, color: ArrayLike) -> Any:
        """Add a geom without gloss to the renderer's scene."""
        scene = self._renderer.scene
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        numbers = (np.asarray(x, float) for x in (size, position, np.eye(3).ravel()))
        mujoco.mjv_initGeom(geom, kind, *numbers, np.asarray(color, np.float32))
        geom.category, geom.specular = mujoco.mjtCatBit.mjCAT_STATIC, 0.0
        return geom

    def close(self) -> None:
        self._renderer.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def check_size(width: int, height: int) -> None:
    """Raise MorlaxError if the size of a picture, in pixels, is out of range."""
    if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
        sides = f"width and height must be from {SMALLEST} to {LARGEST} pixels"
        raise MorlaxError(f"cannot draw a picture of {width} x {height}: {sides}.")


@cache
def choose_opengl() -> None:
    """Set MUJOCO_GL to the first OpenGL backend that works on this machine, or raise MorlaxError.

    They are a hidden window (GLFW) if there is a display, EGL, and OSMesa, or MUJOCO_GL if set.
    """
    backends = [os.environ.get("MUJOCO_GL", "")]
    if not backends[0] and sys.platform == "linux":
        backends = ["glfw", "egl", "osmesa"] if has_display() else ["egl", "osmesa"]
    for backend in backends:
        # in a separate process, because PyOpenGL keeps the first platform it loads
        environment = {**os.environ, "MUJOCO_GL": backend}
        done = subprocess.run([sys.executable, "-c", TRIAL], env=environment, capture_output=True)
        if done.returncode == 0:
            os.environ["MUJOCO_GL"] = backend
            importlib.reload(gl_context)  # MuJoCo read MUJOCO_GL when it was imported
            return
    raise MorlaxError(
        f"OpenGL is not available for rendering (tried: {', '.join(backends)}): install EGL "
        "(Debian: libegl1 and libopengl0) or OSMesa (libosmesa6), or set MUJOCO_GL to an installed "
        "one of glfw, egl and osmesa."
    )
