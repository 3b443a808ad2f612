"""Base class for robots that move in the x-z plane."""

import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.layout import Part, positions, velocities

MAX_VELOCITY = 10.0  # m/s, rad/s; clipping limit of observed velocities


class Planar(Environment):
    """A planar robot that observes its joints, height and pitch, but not its distance x.

    The first entries of qpos are x and z (m) and the pitch (rad) of the torso.
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
        """Return the mean velocity (N,) along x over the control step in m/s."""
        return (self.physics.qpos[:, 0] - self.memory["x"]) / self.dt
