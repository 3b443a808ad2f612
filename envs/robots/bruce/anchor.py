"""Pose of the reference in the world."""

import torch
from torch import Tensor

from . import rotations


class Anchor:
    """Planar pose of the reference frame in the world: x, y (m) and yaw (rad), (N, 3).

    `now` is the current pose, `former` that of the previous control step. Whenever feet change, the
    reference is moved to the robot, so drift in position and heading is not penalized.

    Poses of a base, (N, 7), are its position (m) and quaternion. Tensors are (N, ...) like `like`.
    """

    def __init__(self, like: Tensor):
        self.now = like.new_zeros(len(like), 3)
        self.former = self.now.clone()

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that persists between steps, by name."""
        return {"anchor": self.now, "former_anchor": self.former}

    def begin(self, fresh: Tensor, anchors: Tensor) -> None:
        """Reset to `anchors` (N, 3) where `fresh` (N,) bool."""
        for pose in (self.now, self.former):
            torch.where(fresh[:, None], anchors, pose, out=pose)

    def advance(self, changed: Tensor, target: Tensor, pose: Tensor) -> None:
        """Advance one control step; move the reference to the robot where feet `changed` (N,).

        `target` is the pose of the reference's base in its own frame, `pose` that of the robot's in
        the world.
        """
        self.former.copy_(self.now)
        inverse = rotations.conjugate(target[:, 3:])
        yaw = rotations.yaw_of(rotations.multiply(inverse, pose[:, 3:]))
        xy = pose[:, :2] - rotations.turned(target[:, :2], yaw)
        there = torch.cat([xy, yaw[:, None]], -1)
        torch.where(changed[:, None], there, self.now, out=self.now)

    def seen_from(self, attitude: Tensor, tilt: Tensor) -> Tensor:
        """Return a world attitude (N, 4) relative to the reference's heading, then tilted.

        `tilt` is roll, pitch and yaw of that other rotation, (N, 3) in rad.
        """
        yaw = tilt[:, 2:] - self.now[:, 2:]  # both turn about the same axis
        turn = rotations.from_angles(torch.cat([tilt[:, :2], yaw], -1))
        return rotations.positive(rotations.multiply(turn, attitude))

    def placed(self, target: Tensor) -> tuple[Tensor, Tensor]:
        """Transform the reference's base (N, 7) of the previous control step to the world.

        Returns:
            Position (N, 3) in m and attitude (N, 4).
        """
        yaw = self.former[:, 2]
        xy = rotations.turned(target[:, :2], yaw) + self.former[:, :2]
        attitude = rotations.multiply(rotations.from_yaw(yaw), target[:, 3:])
        return torch.cat([xy, target[:, 2:3]], -1), attitude
