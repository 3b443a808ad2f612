"""Cameras that follow a robot, at a distance that fits the robot's own size."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..envs.worlds.trees import base_of

CAMERA = "track"  # a camera of this name in the model sets the direction of view
SIDE, QUARTER = (90.0, -8.0), (125.0, -14.0)  # azimuth and elevation in degrees
FILL = 0.72  # share of the picture that the robot fills at the start, in width or height
FULL = 0.9  # share above which the camera moves back
EDGE = 0.97  # share that the robot never exceeds
SNUG = 0.86  # share that a row of pictures fills
LAG = 0.3  # s in which the camera follows a change of speed
SHIFT = 1.0  # s in which the camera follows a change of shape
BACK = 0.4  # s in which the camera moves back
SLACK = 0.25  # largest distance from the picture's center, in sizes of the robot
JUMP = 3.0  # sizes of the robot: what moves farther in one step was put there

Points = NDArray[np.float64]  # (P, 3) in world coordinates
HIDDEN_GROUP = 3  # MuJoCo's viewers show geoms of groups 0 to 2 by default
GRAY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)  # the color of a geom that names none
_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


class Area(NamedTuple):
    """A part of a picture: shares of its width from the left, and of its height from below."""

    left: float
    bottom: float
    right: float
    top: float


WHOLE = Area(0.0, 0.0, 1.0, 1.0)


class View:
    """What a picture of a robot shows: from one direction, in one shape.

    The aspect is the picture's width by its height. The robot is placed in the area. Its base is
    the body `base` (None: see `base_of`).
    """

    def __init__(
        self, model: mujoco.MjModel, aspect: float, area: Area = WHOLE, base: int | None = None
    ):
        self._model, self._geoms = model, robot_geoms(model, base)
        self._tree = int(model.body_rootid[base_of(model) if base is None else base])
        tangent = math.tan(math.radians(model.vis.global_.fovy) / 2)
        self._tangents = np.array([tangent * aspect, tangent])
        self._aim = np.array([area.left + area.right, area.bottom + area.top]) - 1.0
        self._half = np.array([area.right - area.left, area.top - area.bottom])
        aside, above = np.degrees(np.arctan(self._aim * self._tangents))
        azimuth, elevation = direction(model)
        self._angles = azimuth + aside, elevation - above  # so that the robot is seen from there
        self._axes = axes(*self._angles)

    def points(self, data: mujoco.MjData) -> Points:
        """Return the corners of the boxes around the robot's geoms."""
        if len(self._geoms):
            return corners(self._model, data, self._geoms)
        return self.mass(data) + 0.5 * np.array([[-1.0], [1.0]])  # nothing is shown

    def mass(self, data: mujoco.MjData) -> Points:
        return data.subtree_com[self._tree].copy()

    def middle(self, points: Points) -> Points:
        """Return the center (3,) of the box around points, as the camera sees them."""
        local = points @ self._axes.T
        return (local.min(0) + local.max(0)) / 2 @ self._axes

    def distance(self, points: Points, center: Points, share: float) -> float:
        """Return the distance at which points lie within a share of the area's width and height.

        The area's own center shows `center` (3,).
        """
        local = (points - center) @ self._axes.T
        back = local[:, 2:]
        sides = np.abs(local[:, :2] / self._tangents + self._aim * back) / (share * self._half)
        return float((sides + back).max())

    def place(self, camera: mujoco.MjvCamera, center: Points, distance: float) -> None:
        """Place a camera so that the area's center shows `center` (3,)."""
        aside = distance * self._aim * self._tangents
        camera.azimuth, camera.elevation = self._angles
        camera.lookat[:] = center - aside @ self._axes[:2]
        camera.distance = distance


class FollowingCamera:
    """A camera that keeps one robot in its picture without shaking.

    It moves with the smoothed speed of the robot's center of mass, and moves back when the robot
    stretches. `camera` is its current pose. Of the free areas of the picture, the robot is placed
    where it is largest.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        aspect: float,
        areas: Sequence[Area] = (WHOLE,),
        base: int | None = None,
    ):
        self._views = [View(model, aspect, area, base) for area in areas]
        self._view = self._views[0]
        self.camera = mujoco.MjvCamera()
        self._center = np.zeros(3)  # smoothed
        self._placed = False

    def restart(self, data: mujoco.MjData) -> None:
        points, self._placed = self._view.points(data), True
        self._center, self._speed = self._view.middle(points), np.zeros(3)
        self._offset = self._center - self._view.mass(data)
        self._size = float(np.linalg.norm(np.ptp(points, axis=0)))
        choices = [view.distance(points, self._center, FILL) for view in self._views]
        self._view = self._views[int(np.argmin(choices))]
        self._view.place(self.camera, self._center, min(choices))

    def follow(self, data: mujoco.MjData, seconds: float) -> None:
        """Move on with the robot, which took `seconds` to get to the pose in `data`.

        A state that is not finite is skipped.
        """
        points, mass = self._view.points(data), self._view.mass(data)
        if not np.isfinite(points).all():
            return
        if not self._placed or self._has_jumped(mass, seconds):
            self.restart(data)
            return
        shift = self._view.middle(points) - mass - self._offset
        self._offset = self._offset + (1 - math.exp(-seconds / SHIFT)) * shift
        target = mass + self._offset
        error = target - self._center - self._speed * seconds
        keep = math.exp(-seconds / LAG)  # an alpha-beta filter: no lag at a constant speed
        self._speed = self._speed + (1 - keep) ** 2 / seconds * error
        slack = SLACK * self._size
        self._center = target - np.clip(keep**2 * error, -slack, slack)
        distance = self.camera.distance
        more = max(0.0, self._view.distance(points, self._center, FULL) - distance)
        distance += (1 - math.exp(-seconds / BACK)) * more
        edge = self._view.distance(points, self._center, EDGE)
        self._view.place(self.camera, self._center, max(distance, edge))

    def stand_back(self, distance: float) -> None:
        """Look from at least this distance, now and later."""
        self._view.place(self.camera, self._center, max(distance, self.camera.distance))

    def _has_jumped(self, mass: Points, seconds: float) -> bool:
        moved = mass + self._offset - self._center - self._speed * seconds
        return float(np.linalg.norm(moved)) > JUMP * self._size


def cameras_for(
    model: mujoco.MjModel, aspect: float, poses: Sequence[mujoco.MjData], base: int | None = None
) -> list[mujoco.MjvCamera]:
    """Return a camera for each pose: all at one height and distance, centered on the robot."""
    view = View(model, aspect, base=base)
    bodies = [view.points(pose) for pose in poses]
    centers = [view.middle(points) * (1, 1, 0) for points in bodies]
    together = np.concatenate([p - center for p, center in zip(bodies, centers, strict=True)])
    middle = view.middle(together)
    distance = view.distance(together, middle, SNUG)
    cameras = [mujoco.MjvCamera() for _ in poses]
    for camera, center in zip(cameras, centers, strict=True):
        view.place(camera, center + middle, distance)
    return cameras


def direction(model: mujoco.MjModel) -> tuple[float, float]:
    """Return the direction of view, azimuth and elevation in degrees.

    The direction of the model's camera `track`, a side view of a planar robot, or from ahead.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if named >= 0:
        x, y, z = -data.cam_xmat[named].reshape(3, 3)[:, 2]
        return math.degrees(math.atan2(y, x)), math.degrees(math.asin(np.clip(z, -1, 1)))
    if _moves_within(model, data, normal=1):
        return SIDE
    if _moves_within(model, data, normal=0):
        return SIDE[0] + 90, SIDE[1]
    return QUARTER


def axes(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Return the directions right, up and back (3, 3) of a camera; angles are in degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    back = -np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    return np.stack([right, np.cross(back, right), back])


def _moves_within(model: mujoco.MjModel, data: mujoco.MjData, normal: int) -> bool:
    """Return whether every joint moves within the plane whose normal is a coordinate axis."""
    along = np.abs(data.xaxis[:, normal])
    hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    slide = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    within = (hinge & (along > 0.99)) | (slide & (along < 0.01))
    return bool(model.njnt and within.all())


def geom_colors(model: mujoco.MjModel) -> NDArray[np.float32]:
    """Return red, green, blue and opacity (ngeom, 4) as MuJoCo draws them.

    A geom's own color is used if it has no material, or if it is not the default gray.
    """
    own, material = model.geom_rgba, model.geom_matid
    if not model.nmat:
        return own
    covered = (material >= 0) & (own == GRAY).all(1)
    return np.where(covered[:, None], model.mat_rgba[material], own)


def shown_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    return (model.geom_group < HIDDEN_GROUP) & (geom_colors(model)[:, 3] > 0)


def robot_geoms(model: mujoco.MjModel, base: int | None = None) -> NDArray[np.intp]:
    """Return the shown geoms that move with the kinematic tree of the robot's base.

    Every geom that moves if that tree has none; every geom that has a size if nothing moves.
    """
    moves = model.body_weldid[model.geom_bodyid] > 0
    sized = (model.geom_rbound > 0) & shown_geoms(model)
    tree = model.body_rootid[base_of(model) if base is None else base]
    ours = model.body_rootid[model.geom_bodyid] == tree
    for mask in (sized & moves & ours, sized & moves, sized):
        if mask.any():
            return np.flatnonzero(mask)
    return np.empty(0, np.intp)


def corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray) -> NDArray[np.float64]:
    """Return the corners (8 G, 3) of the boxes around G geoms, in world coordinates."""
    center, half = np.split(model.geom_aabb[geoms], 2, axis=-1)  # (G, 3) each
    local = center[:, None] + _SIGNS * half[:, None]  # (G, 8, 3)
    turned = local @ data.geom_xmat[geoms].reshape(-1, 3, 3).swapaxes(1, 2)
    return (turned + data.geom_xpos[geoms, None]).reshape(-1, 3)
