"""Cameras that follow a robot, at a distance that fits the robot's own size."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..envs.worlds.trees import base_of, forwarded

CAMERA = "track"  # a camera of this name in the model sets the direction of view
FILL, FULL = 0.9, 1.0  # share of a picture that the robot's reach fills at the start, and at most
RISE = 0.5  # s in which the camera follows the robot's height
HIDDEN_GROUP = 3  # MuJoCo's viewers show geoms of groups 0 to 2 by default
GRAY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)  # the color of a geom that names none


class Area(NamedTuple):
    """A part of a picture: shares of its width from the left, and of its height from below."""

    left: float
    bottom: float
    right: float
    top: float


class FollowingCamera:
    """A camera that moves with a robot's center of mass, and back when the robot stretches.

    `camera` is its current pose, `aspect` the picture's width by its height, `base` a body of the
    robot. Of the free areas of the picture (none: all), the robot is placed where it is largest.
    """

    def __init__(self, model: mujoco.MjModel, aspect: float, base: int, areas: Sequence[Area] = ()):
        self.base, self._model, self.camera = base, model, mujoco.MjvCamera()
        self.camera.azimuth, self.camera.elevation = direction(model)
        half = math.tan(math.radians(model.vis.global_.fovy) / 2)  # height at a distance of 1 m
        areas = areas or [Area(0.0, 0.0, 1.0, 1.0)]
        rooms = [min((x.right - x.left) * aspect, x.top - x.bottom) * half for x in areas]
        self._room, area = max(zip(rooms, areas, strict=True))
        a, e = np.radians([self.camera.azimuth, self.camera.elevation])
        right = np.array([math.sin(a), -math.cos(a), 0.0])
        up = np.array([-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)])
        aside, above = area.left + area.right - 1, area.bottom + area.top - 1
        self._shift = half * (aside * aspect * right + above * up)  # to the area's middle, per m
        self._center = np.zeros(3)

    def restart(self, data: mujoco.MjData) -> None:
        self._center = data.subtree_com[self.base].copy()
        self.camera.distance = self._needed(data, FILL)
        self.stand_back(0.0)

    def follow(self, data: mujoco.MjData, seconds: float) -> None:
        """Move on with the robot for `seconds` to the pose in `data`, if it is finite."""
        center = data.subtree_com[self.base].copy()
        if np.isfinite(center).all():
            # slower than the robot's height, so that jumps show
            center[2] += math.exp(-seconds / RISE) * (self._center[2] - center[2])
            self._center = center
            self.stand_back(self._needed(data, FULL))

    def stand_back(self, distance: float) -> None:
        """Look from at least this distance, now and later."""
        self.camera.distance = max(distance, self.camera.distance)
        self.camera.lookat[:] = self._center - self.camera.distance * self._shift

    def _needed(self, data: mujoco.MjData, share: float) -> float:
        """Return the distance at which a ball around the robot fills a share of its area."""
        ball = _radius(self._model, data, self.base, self._center)
        return ball * math.hypot(1.0, 1 / (share * self._room))


def cameras_for(
    model: mujoco.MjModel, aspect: float, poses: Sequence[mujoco.MjData], base: int
) -> list[mujoco.MjvCamera]:
    """Return a camera for each pose: all at one height and distance, centered on the robot."""
    following = [FollowingCamera(model, aspect, base) for _ in poses]
    for each, pose in zip(following, poses, strict=True):
        each.restart(pose)
    for each in following:
        each.stand_back(max(other.camera.distance for other in following))
        each.camera.lookat[2] = np.mean([other._center[2] for other in following])
    return [each.camera for each in following]


def direction(model: mujoco.MjModel) -> tuple[float, float]:
    """Return azimuth and elevation in degrees: the camera `track`, a side view, or from ahead."""
    data = forwarded(model)
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if camera >= 0:
        x, y, z = -data.cam_xmat[camera].reshape(3, 3)[:, 2]
        return math.degrees(math.atan2(y, x)), math.degrees(math.asin(np.clip(z, -1, 1)))
    hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    slide = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    for normal, azimuth in ((1, 90.0), (0, 180.0)):  # of a planar robot
        along = np.abs(data.xaxis[:, normal])
        if model.njnt and ((hinge & (along > 0.99)) | (slide & (along < 0.01))).all():
            return azimuth, -8.0
    return 125.0, -14.0


def shown_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which geoms (ngeom,) MuJoCo's viewers draw."""
    opacity = model.geom_rgba[:, 3]
    if model.nmat:  # a geom's own color counts if it is not the default gray
        plain = (model.geom_matid >= 0) & (model.geom_rgba == GRAY).all(1)
        opacity = np.where(plain, model.mat_rgba[model.geom_matid, 3], opacity)
    return (model.geom_group < HIDDEN_GROUP) & (opacity > 0)


def reach(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """Return the least height that the robot can reach in m, and the size of its pose in `data`."""
    base = base_of(model)
    radius = _radius(model, data, base, data.xpos[base])
    return float(data.xpos[base, 2]) - radius, 2 * radius


def _radius(model: mujoco.MjModel, data: mujoco.MjData, base: int, center: np.ndarray) -> float:
    """Return how far the shown geoms of the base's tree reach; else all that move; else all."""
    moves = model.body_weldid[model.geom_bodyid] > 0
    sized = (model.geom_rbound > 0) & shown_geoms(model)
    attached = model.body_rootid[model.geom_bodyid] == model.body_rootid[base]
    masks = (sized & moves & attached, sized & moves, sized)
    geoms = next((mask for mask in masks if mask.any()), sized)
    away = np.linalg.norm(data.geom_xpos[geoms] - center, axis=1)
    return float((away + model.geom_rbound[geoms]).max(initial=0.1))
