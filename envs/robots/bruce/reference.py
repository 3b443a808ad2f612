"""Reference walk of N worlds and its pose: gaits of the library, blended when the velocity changes.

Each world follows a segment: the rest of its current step, reparametrized to [0, 1]. All updates
are in-place arithmetic on whole tensors, so that a CUDA graph can record them.
"""

from importlib import resources
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from . import rotations

DEGREE = 7  # of the Bezier curves

JOINTS, POSITION, ANGLES = slice(16), slice(16, 19), slice(19, 22)  # of control points and rates
BASE = slice(16, 23)  # of targets: position and quaternion

BLENDING = 0.7  # phase after which a step is no longer changed
LATE = 0.005  # s already elapsed when a step begins: half the lag in detecting its start
EARLY = 0.01  # s already elapsed when an episode begins


class Library(NamedTuple):
    """A gait for each velocity of a grid, with X velocities forward and Y sideways.

    A gait is two steps that repeat, each a Bezier curve. `benchmarks/plan_gaits.py` plans them.
    """

    vx: np.ndarray  # (X,) m/s
    vy: np.ndarray  # (Y,) m/s
    joints: np.ndarray  # (X, Y, 2, 8, 16) control points in crank coordinates
    base: np.ndarray  # (X, Y, 2, 8, 6) position, roll, pitch, yaw, in the sole's frame
    step_time: np.ndarray  # () s

    @classmethod
    def load(cls) -> Self:
        """Load the library of the package."""
        names = "vx", "vy", "joints", "base", "constants.step_time"
        with (resources.files(str(__package__)) / "gaits.npz").open("rb") as file:
            contents = np.load(file)
            return cls(*(contents[name] for name in names))


class Reference:
    """State of the reference walk, with rows, dtype and device as in `like` (N, ...).

    Its frame has planar poses in the world: x, y (m) and yaw (rad). Poses of a base, (N, 7), are
    its position (m) and quaternion.
    """

    def __init__(self, library: Library, like: Tensor):
        curves = torch.cat([torch.from_numpy(library.joints), torch.from_numpy(library.base)], -1)
        self.step_time = library.step_time.item()
        # The four gaits around each cell of the library's grid, (X - 1, Y - 1, 2, 2, 2, 8, 22).
        corners = curves.to(like).unfold(0, 2, 1).unfold(1, 2, 1)
        self._corners = corners.movedim((-2, -1), (3, 4)).contiguous()
        grid = [torch.from_numpy(v).to(like) for v in (library.vx, library.vy)]
        self._slowest = torch.stack([v[0] for v in grid])
        self._spacing = torch.stack([(v[-1] - v[0]) / (len(v) - 1) for v in grid])
        self._last_cell = torch.tensor([len(v) - 2 for v in grid], device=like.device)
        self._first_cell, self._end = torch.zeros_like(self._last_cell), self._last_cell + 1
        # A blended segment starts like the former one and ends like the new gait.
        self._blend = like.new_tensor([0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0, 1.0])[:, None]
        N = len(like)
        self.points = like.new_zeros(N, *curves.shape[3:])  # (N, 8, 22)
        self.duration = like.new_full((N,), self.step_time)  # s, of the segment
        self.elapsed = like.new_zeros(N)  # s, of the segment
        self.step_elapsed = like.new_zeros(N)  # s, of the step
        self.leg = torch.zeros(N, dtype=torch.int64, device=like.device)  # 0: left swings
        self.velocity = like.new_zeros(N, 2)  # m/s, of the segment
        self.anchor = like.new_zeros(N, 3)  # pose of the frame
        self.former_anchor = like.new_zeros(N, 3)  # the same in the previous control step

    @property
    def phase(self) -> Tensor:
        """Return the elapsed share (N,) of the step, from 0 to 1."""
        return self.step_elapsed / self.step_time

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that persists between steps, by name."""
        names = "points", "duration", "elapsed", "step_elapsed", "leg", "velocity"
        return {name: getattr(self, name) for name in (*names, "anchor", "former_anchor")}

    def gaits(self, velocity: Tensor, leg: Tensor) -> Tensor:
        """Interpolate control points (N, 8, 22) of steps of legs (N,) at velocities (N, 2)."""
        at = ((velocity - self._slowest) / self._spacing).clamp(self._first_cell, self._end)
        # clamped again to keep the index valid if a velocity is NaN
        cell = at.long().clamp(self._first_cell, self._last_cell)
        forward, left = (at - cell)[..., None, None].unbind(1)
        corners = self._corners[*cell.unbind(1), leg]
        sides = torch.lerp(corners[:, 0], corners[:, 1], forward[:, None])
        return torch.lerp(sides[:, 0], sides[:, 1], left)

    def begin(
        self, fresh: Tensor, velocity: Tensor, leg: Tensor, points: Tensor, anchor: Tensor
    ) -> None:
        """Restart the walk where `fresh` (N,) bool; `points` are `gaits(velocity, leg)`."""
        torch.where(fresh[:, None], velocity, self.velocity, out=self.velocity)
        for pose in (self.anchor, self.former_anchor):
            torch.where(fresh[:, None], anchor, pose, out=pose)
        torch.where(fresh, leg, self.leg, out=self.leg)
        self._start_step(fresh, points, EARLY)

    def advance(self, velocity: Tensor, dt: float) -> Tensor:
        """Blend toward the gaits for velocities (N, 2) and advance time by `dt` (s).

        Steps are blended while their phase is below BLENDING: the rests of the current segment and
        of the new gait become the new segment. Returns where feet changed, (N,) bool.
        """
        blendable = self.phase < BLENDING
        done, rest = self.elapsed / self.duration, self.duration - self.elapsed
        torch.where(blendable[:, None], velocity, self.velocity, out=self.velocity)
        torch.where(blendable, rest, self.duration, out=self.duration)
        self.elapsed.masked_fill_(blendable, 0.0)
        self.elapsed += dt
        self.step_elapsed += dt
        changed = self.elapsed >= self.duration
        self.leg ^= changed
        # Feet change long after BLENDING, so no world needs a gait for both.
        gaits = self.gaits(self.velocity, self.leg)
        shares = torch.stack([done, 1 - rest / self.step_time], 1)
        rests = _rest(torch.stack([self.points, gaits], 1), shares)
        blended = torch.lerp(rests[:, 0], rests[:, 1], self._blend)
        torch.where(blendable[:, None, None], blended, self.points, out=self.points)
        self._start_step(changed, gaits, LATE)
        return changed

    def now(self) -> tuple[Tensor, Tensor]:
        """Return the current target (N, 23), see BASE, and its rates (N, 22), see ANGLES."""
        s = (self.elapsed / self.duration).clamp(0, 1)[:, None, None]
        points = self.points
        for _ in range(DEGREE - 1):  # de Casteljau
            points = torch.lerp(points[:, :-1], points[:, 1:], s)
        first, last = points.unbind(1)
        value = torch.lerp(first, last, s[:, 0])
        target = torch.cat([value[:, :19], rotations.from_angles(value[:, ANGLES])], -1)
        return target, DEGREE * (last - first) / self.duration[:, None]

    def follow(self, changed: Tensor, target: Tensor, pose: Tensor) -> None:
        """Move the frame to the robot where feet `changed` (N,): no drift is penalized.

        `target` is the pose of the reference's base in its own frame, `pose` that of the robot's in
        the world.
        """
        self.former_anchor.copy_(self.anchor)
        inverse = rotations.conjugate(target[:, 3:])
        yaw = rotations.yaw_of(rotations.multiply(inverse, pose[:, 3:]))
        xy = pose[:, :2] - rotations.turned(target[:, :2], yaw)
        there = torch.cat([xy, yaw[:, None]], -1)
        torch.where(changed[:, None], there, self.anchor, out=self.anchor)

    def seen_from(self, attitude: Tensor, tilt: Tensor) -> Tensor:
        """Return a world attitude (N, 4) relative to the reference's heading, then tilted.

        `tilt` is roll, pitch and yaw of that other rotation, (N, 3) in rad.
        """
        yaw = tilt[:, 2:] - self.anchor[:, 2:]  # both turn about the same axis
        turn = rotations.from_angles(torch.cat([tilt[:, :2], yaw], -1))
        seen = rotations.multiply(turn, attitude)
        return torch.where(seen[:, :1] < 0, -seen, seen)  # the same rotation, with w >= 0

    def placed(self, target: Tensor) -> tuple[Tensor, Tensor]:
        """Transform the reference's base (N, 7) of the previous control step to the world.

        Returns the position (N, 3) in m and attitude (N, 4).
        """
        xy, yaw = self.former_anchor.split([2, 1], -1)
        position = [rotations.turned(target[:, :2], yaw[:, 0]) + xy, target[:, 2:3]]
        turn = rotations.from_angles(torch.nn.functional.pad(yaw, (2, 0)))
        return torch.cat(position, -1), rotations.multiply(turn, target[:, 3:])

    def _start_step(self, where: Tensor, points: Tensor, elapsed: float) -> None:
        torch.where(where[:, None, None], points, self.points, out=self.points)
        self.duration.masked_fill_(where, self.step_time)
        self.elapsed.masked_fill_(where, elapsed)
        self.step_elapsed.masked_fill_(where, elapsed)


def _rest(points: Tensor, s: Tensor) -> Tensor:
    """Return the control points of curves (..., 8, C) restricted to [s, 1], s (...,)."""
    s = s[..., None, None]
    lasts = []
    for _ in range(DEGREE):  # de Casteljau
        lasts.append(points[..., -1:, :])
        points = torch.lerp(points[..., :-1, :], points[..., 1:, :], s)
    return torch.cat([points, *reversed(lasts)], -2)
