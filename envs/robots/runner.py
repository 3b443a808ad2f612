"""Base class of robots that observe their joints and are rewarded for moving."""

import math
from typing import ClassVar

import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.mujoco_robot import Part, positions, velocities
from ..worlds.options import Objectives, TaskOptions

UNITS = {"inertias": "kg m^2, kg m, kg", "velocities": "rad/s, m/s"}  # others are N m, N


class RunEnergy(TaskOptions):
    """Options of a task with the terms of `Runner`."""

    objectives: Objectives = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
    shared: dict[str, float] = {"alive": 1.0}
    nconmax: int = 16


class Runner(Environment):
    """A robot that observes `qpos`, but for its position on the floor, and `qvel`."""

    unobserved: ClassVar[int] = 1  # leading entries of qpos: position on the floor
    fastest_seen: ClassVar[float] = math.inf  # clipping limit of observed velocities

    def observe(self) -> Tensor:
        seen, limit = self.physics.qvel, self.fastest_seen
        if limit < math.inf:
            seen = seen.clamp(-limit, limit)
        joints = self.physics.qpos[:, self.unobserved :]
        return torch.cat([joints, seen, *self.seen_of_bodies().values()], -1)

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(action.clamp(-1, 1))

    def layout(self) -> list[Part]:
        model = self.physics.model
        parts = [*positions(model)[self.unobserved :], *velocities(model, self.fastest_seen)]
        for name, values in self.seen_of_bodies().items():
            parts.append(Part(name, values.shape[1], UNITS.get(name, "N m, N")))
        return parts

    def terms(self) -> dict[str, Tensor]:
        speed = self.speed()
        return {"alive": torch.ones_like(speed), "run": speed, "energy": 4.0 - self.effort()}

    def seen_of_bodies(self) -> dict[str, Tensor]:
        """Return observed quantities of the bodies by name, (N, ...) each."""
        return {}

    def place(self) -> Tensor:
        """Return the position (N, 2) in m from which `velocity` is computed; x comes first."""
        return self.physics.qpos[:, :2]

    def remember(self) -> dict[str, Tensor]:
        return {"place": self.place()}

    def velocity(self) -> Tensor:
        """Return the mean velocity (N, 2) of `place` over the control step in m/s."""
        return (self.place() - self.memory["place"]) / self.dt

    def speed(self) -> Tensor:
        """Return the mean velocity (N,) along x over the control step in m/s."""
        return self.velocity()[:, 0]

    def effort(self) -> Tensor:
        """Return the sum of squared controls (N,)."""
        return self.physics.ctrl.square().sum(-1)
