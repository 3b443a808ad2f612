"""Default looks: what viewers add to a model that has no sky, no light or no floor.

Looks are decided from the model alone, and physics never sees them: a viewer adds them to its own
scene. Everything that a model defines stays as it is.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from .camera import corners, robot_geoms, shown_geoms

Color = tuple[float, float, float]  # red, green, blue in [0, 1]

ZENITH: Color = (0.42, 0.58, 0.76)
HORIZON: Color = (0.91, 0.94, 0.97)
FLOOR: Color = (0.87, 0.90, 0.94)  # of a floor that has no color
SUN = np.array([0.25, 0.35, -1.0]) / np.linalg.norm([0.25, 0.35, -1.0])  # direction of its rays
DIFFUSE = 0.5  # brightness of the added light
AMBIENT = 0.4  # of all lights together
DIM = 0.8  # ambient plus diffuse; headlights dimmer than this do not light a scene
LEVEL = 0.95  # cosine of the steepest floor
POSES = 64  # random poses that say how low a robot reaches
MUJOCO_GRAY = (0.5, 0.5, 0.5, 1.0)  # of a geom that has no color


@dataclass(frozen=True)
class Looks:
    """What a model lacks for a good picture."""

    sky: bool  # a gradient from HORIZON to ZENITH
    light: bool  # a light with shadows along SUN
    ambient: float  # ambient brightness that the added light has too
    plain_floors: tuple[int, ...]  # floors without a material: geom ids, to be checkered
    ground: float | None  # height in meters of a ground to be drawn; None: there is a floor
    size: float  # diameter of the robot in meters

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Looks":
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        shown, planes = shown_geoms(model), _level_planes(model, data)
        head = model.vis.headlight
        ambient = float(np.max(head.ambient)) if head.active else 0.0
        bright = ambient + float(np.max(head.diffuse)) >= DIM if head.active else False
        size = robot_size(model, data)
        floor = shown & (planes | _terrain(model, data, size))
        return cls(
            sky=mujoco.mjtTexture.mjTEXTURE_SKYBOX not in model.tex_type,
            light=not bright and not np.any(model.light_active),
            ambient=max(0.0, AMBIENT - ambient),
            plain_floors=tuple(np.flatnonzero(shown & planes & (model.geom_matid < 0)).tolist()),
            ground=None if floor.any() else _lowest(model, data) - 0.02 * size,
            size=size,
        )


def robot_size(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the diagonal in meters of the box around the robot in the pose of `data`."""
    geoms = robot_geoms(model)
    return float(np.linalg.norm(np.ptp(corners(model, data, geoms), axis=0))) if len(geoms) else 1.0


def floor_color(model: mujoco.MjModel, geom: int) -> NDArray[np.float32]:
    """Return the color (4,) of a floor without a material: its own, or FLOOR if it has none."""
    own = model.geom_rgba[geom]
    return np.array((*FLOOR, 1.0), np.float32) if np.allclose(own, MUJOCO_GRAY) else own


def _level_planes(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.bool_]:
    kind, upward = model.geom_type, data.geom_xmat[:, 8]
    return (kind == mujoco.mjtGeom.mjGEOM_PLANE) & (upward > LEVEL)


def _terrain(model: mujoco.MjModel, data: mujoco.MjData, size: float) -> NDArray[np.bool_]:
    """Return a mask (ngeom,) of height fields, and of still geoms that are as wide as a floor."""
    found = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
    for geom in np.flatnonzero((model.body_weldid[model.geom_bodyid] == 0) & ~found):
        box = corners(model, data, np.array([geom]))
        wide = np.ptp(box[:, :2], axis=0).min() >= 2 * size
        found[geom] = wide and np.ptp(box[:, 2]) < size
    return found


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the lowest point at the start, and that hinges can turn to."""
    geoms = np.flatnonzero(shown_geoms(model) & (model.geom_rbound > 0))
    if not len(geoms):
        return 0.0
    lowest = corners(model, data, geoms)[:, 2].min()
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    limited = model.jnt_limited[hinges].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[hinges], (-np.pi, np.pi)).T
    draw, posed = np.random.default_rng(0), mujoco.MjData(model)
    for _ in range(POSES if len(hinges) else 0):
        posed.qpos[model.jnt_qposadr[hinges]] = draw.uniform(low, high)
        mujoco.mj_kinematics(model, posed)
        lowest = min(lowest, corners(model, posed, geoms)[:, 2].min())
    return float(lowest)
