"""Where in the world the reference stands."""

import torch
from torch import Tensor

from . import rotations
from .beginnings import ANGLES, POSITION


class Anchor:
    """`now` and `former`, one control step ago: x, y (m) and yaw (rad) of the reference, (N, 3).

    It is put where the robot is whenever feet change: drift of place and heading is forgiven.

    Args:
        like: (N, ...) whose number of worlds, dtype and device to take.
    """

    def __init__(self, like: Tensor):
        self.now = like.new_zeros(len(like), 3)
        self.former = self.now.clone()

    def state(self) -> dict[str, Tensor]:
        """Every tensor that the future depends on."""
        return {"anchor": self.now, "former_anchor": self.former}

    def begin(self, fresh: Tensor, anchors: Tensor) -> None:
        """Start anew at `anchors` (N, 3) where `fresh` (N,)."""
        here = fresh[:, None]
        self.now.copy_(torch.where(here, anchors, self.now))
        self.former.copy_(torch.where(here, self.now, self.former))

    def advance(self, changed: Tensor, asked: Tensor, pose: Tensor) -> None:
        """A step later: where feet `changed` (N,), the reference's base comes to the robot's.

        Args:
            asked: the reference's joints and base, (N, 22).
            pose: of the robot's base, position and quaternion, (N, 7).
        """
        self.former.copy_(self.now)
        difference = rotations.multiply(
            rotations.conjugate(rotations.from_angles(asked[:, ANGLES])), pose[:, 3:]
        )
        yaw = rotations.yaw_of(difference)
        xy = pose[:, :2] - rotations.turned(asked[:, POSITION][:, :2], yaw)
        there = torch.cat([xy, yaw[:, None]], -1)
        self.now.copy_(torch.where(changed[:, None], there, self.now))

    def seen_from(self, attitude: Tensor) -> Tensor:
        """An attitude (N, 4) in the world, relative to the heading of the reference."""
        heading = rotations.conjugate(rotations.from_yaw(self.now[:, 2]))
        return rotations.multiply(heading, attitude)

    def placed(self, base: Tensor) -> tuple[Tensor, Tensor]:
        """Position (N, 3) and attitude (N, 4) in the world of the base (N, 7) of one step ago."""
        yaw = self.former[:, 2]
        xy = rotations.turned(base[:, :2], yaw) + self.former[:, :2]
        attitude = rotations.multiply(rotations.from_yaw(yaw), base[:, 3:])
        return torch.cat([xy, base[:, 2:3]], -1), attitude
