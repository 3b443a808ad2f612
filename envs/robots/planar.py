"""What robots that cannot leave the x-z plane have in common."""

import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.layout import Part, positions, velocities

MAX_VELOCITY = 10.0  # m/s, rad/s; what is faster looks like this


class Planar(Environment):
    """It sees its joints, how high it is and how it leans, but not how far it has come.

    The first positions are x, z and the pitch of its torso, in metres and radians.
    """

    def observe(self) -> Tensor:
        limit = MAX_VELOCITY
        return torch.cat([self.physics.qpos[:, 1:], self.physics.qvel.clamp(-limit, limit)], -1)

    def layout(self) -> list[Part]:
        model = self.physics.model
        return [*positions(model)[1:], *velocities(model, MAX_VELOCITY)]

    def remember(self) -> dict[str, Tensor]:
        return {"x": self.physics.qpos[:, 0]}

    def speed(self) -> Tensor:
        """(N,) along x, the mean over the control step, in m/s."""
        return (self.physics.qpos[:, 0] - self.memory["x"]) / self.dt
