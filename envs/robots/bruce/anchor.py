"""Pose of the reference in the world."""

import torch
from torch import Tensor

from . import rotations
from .beginnings import ANGLES, POSITION


class Anchor:
    """Planar pose of the reference frame in the world: x, y (m) and yaw (rad), (N, 3).

    `now` is the current pose, `former` that of the previous control step. Whenever feet change, the
    reference is moved to the robot, so drift in position and heading is not penalized.

    Args:
        like: (N, ...) tensor that sets the number of worlds, dtype and device.
    """

    def __init__(self, like: Tensor):
        self.now = like.new_zeros(len(like), 3)
        self.former = self.now.clone()

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that persists between steps, by name."""
        return {"anchor": self.now, "former_anchor": self.former}

    def begin(self, fresh: Tensor, anchors: Tensor) -> None:
        """Reset to `anchors` (N, 3) where `fresh` (N,) bool."""
        here = fresh[:, None]
        self.now.copy_(torch.where(here, anchors, self.now))
        self.former.copy_(torch.where(here, self.now, self.former))

    def advance(self, changed: Tensor, target: Tensor, pose: Tensor) -> None:
        """Advance one control step; move the reference to the robot where feet changed.

        Args:
            changed: (N,) bool, true where feet changed.
            target: joints and base of the reference, (N, 22).
            pose: position and quaternion of the robot's base, (N, 7).
        """
        self.former.copy_(self.now)
        difference = rotations.multiply(
            rotations.conjugate(rotations.from_angles(target[:, ANGLES])), pose[:, 3:]
        )
        yaw = rotations.yaw_of(difference)
        xy = pose[:, :2] - rotations.turned(target[:, POSITION][:, :2], yaw)
        there = torch.cat([xy, yaw[:, None]], -1)
        self.now.copy_(torch.where(changed[:, None], there, self.now))

    def seen_from(self, attitude: Tensor) -> Tensor:
        """Return a world attitude (N, 4) relative to the heading of the reference."""
        heading = rotations.conjugate(rotations.from_yaw(self.now[:, 2]))
        return rotations.multiply(heading, attitude)

    def placed(self, base: Tensor) -> tuple[Tensor, Tensor]:
        """Transform the reference's base (N, 7) of the previous control step to the world.

        Returns:
            Position (N, 3) in m and attitude (N, 4).
        """
        yaw = self.former[:, 2]
        xy = rotations.turned(base[:, :2], yaw) + self.former[:, :2]
        attitude = rotations.multiply(rotations.from_yaw(yaw), base[:, 3:])
        return torch.cat([xy, base[:, 2:3]], -1), attitude
