"""Default looks in MuJoCo's renderer, added to each picture: models and states stay as they are."""

from typing import Any

import mujoco
import numpy as np

from ..looks import DIFFUSE, FLOOR, HORIZON, SUN, ZENITH, Looks, floor_color

MATERIAL = 999  # the last one that a renderer has room for
WIDE = 40.0  # half the side of an added ground, in sizes of the robot
SHADE = 0.91  # brightness of the darker squares of a floor


class Scenery:
    """Light, floor and sky that a model lacks, in the OpenGL context of a renderer."""

    def __init__(self, renderer: mujoco.Renderer, model: mujoco.MjModel, looks: Looks):
        self._looks = looks
        self._floors = {geom: floor_color(model, geom) for geom in looks.plain_floors}
        self._scene = renderer.scene
        self._geoms, self._lights = self._scene.geoms, self._scene.lights  # slow to get
        self._square = 2.0 ** round(np.log2(looks.size / 2))  # side in meters
        self._opengl, self._context = renderer._gl_context, renderer._mjr_context
        context = self._context
        assert context is not None  # the renderer is open
        # textures can be uploaded only with a model, and are shared within an OpenGL context
        self._textures = mujoco.MjrContext(_textures(), mujoco.mjtFontScale.mjFONTSCALE_50.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        self._first = first = context.ntexture
        context.ntexture += 2 if looks.sky else 1
        context.texture[first : context.ntexture] = self._textures.texture[: 1 + looks.sky]
        context.textureType[first : context.ntexture] = self._textures.textureType[: 1 + looks.sky]
        roles = len(context.mat_texid) // len(context.mat_texuniform)
        context.mat_texid[MATERIAL * roles + mujoco.mjtTextureRole.mjTEXROLE_RGB.value] = first
        context.mat_texuniform[MATERIAL] = 1
        context.mat_texrepeat[2 * MATERIAL : 2 * MATERIAL + 2] = 0.5 / self._square

    def add(self, camera: mujoco.MjvCamera) -> None:
        """Add light and floor to the renderer's scene, around the point that `camera` looks at."""
        for geom in self._geoms[: self._scene.ngeom] if self._floors else ():
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in self._floors:
                _paint(geom, self._floors[geom.objid])
        if self._looks.light:
            self._add_lights(camera.lookat)
        if self._looks.ground is not None:
            self._add_ground(camera.lookat, self._looks.ground)

    def close(self) -> None:
        """Free the textures; call it before closing the renderer."""
        if self._opengl:
            self._opengl.make_current()
        if self._context is not None:
            self._context.ntexture = self._first
        self._textures.free()

    def _add_lights(self, center: np.ndarray) -> None:
        sun = self._new_light()
        sun.castshadow, sun.diffuse[:], sun.specular[:] = 1, DIFFUSE, 0.3
        sun.pos[:], sun.dir[:] = center - 4 * self._looks.size * SUN, SUN
        self._new_light().ambient[:] = self._looks.ambient  # a light's own is dark in its shadows

    def _new_light(self) -> Any:
        """Add a directional light without attenuation, at zero intensity."""
        light = self._lights[self._scene.nlight]
        self._scene.nlight += 1
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.id, light.headlight, light.texid, light.castshadow = -1, 0, -1, 0
        light.dir[:], light.attenuation[:] = (0, 0, -1), (1, 0, 0)
        light.ambient[:] = light.diffuse[:] = light.specular[:] = 0
        return light

    def _add_ground(self, center: np.ndarray, height: float) -> None:
        ground = self._geoms[self._scene.ngeom]
        self._scene.ngeom += 1
        half, period = WIDE * self._looks.size, 2 * self._square
        x, y = np.round(center[:2] / period) * period  # squares stay in place
        place, size = np.array([x, y, height]), np.array([half, half, 0.1])
        color = np.array((*FLOOR, 1), np.float32)
        kind = mujoco.mjtGeom.mjGEOM_PLANE
        mujoco.mjv_initGeom(ground, kind, size, place, np.eye(3).ravel(), color)
        ground.category = mujoco.mjtCatBit.mjCAT_STATIC
        _paint(ground, color)


def _paint(floor: Any, color: np.ndarray) -> None:
    """Give a plane of a scene the checkered material."""
    floor.matid, floor.rgba[:] = MATERIAL, color
    floor.specular, floor.shininess = 0.1, 0.3


def _textures() -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    texture = mujoco.mjtTexture
    builtin = mujoco.mjtBuiltin
    spec.add_texture(
        name="floor",
        type=texture.mjTEXTURE_2D,
        builtin=builtin.mjBUILTIN_CHECKER,
        width=256,
        height=256,
        rgb1=(1, 1, 1),
        rgb2=(SHADE, SHADE, SHADE),
    )
    spec.add_texture(
        name="sky",
        type=texture.mjTEXTURE_SKYBOX,
        builtin=builtin.mjBUILTIN_GRADIENT,
        width=256,
        height=1536,
        rgb1=HORIZON,
        rgb2=ZENITH,
    )
    model = spec.compile()
    model.vis.quality.shadowsize, model.vis.quality.offsamples = 0, 0
    model.vis.global_.offwidth, model.vis.global_.offheight = 1, 1
    return model
