"""Robots that move in space: the ant and the humanoid."""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ..worlds.mujoco_robot import Part, positions, velocities
from ..worlds.options import Objectives, TaskOptions
from .runner import RunEnergy, Runner

MIN_UPRIGHT = 0.45  # world-z of the ant's up axis, a tilt of 63 degrees
# The humanoid's motors clip control to [-1, 1]; its energy term uses the unclipped action.
ACTION_SCALE = 3.0
EXTREMITIES = ("right_hand", "left_hand", "right_foot", "left_foot")


class Ant(Runner):
    """A quadruped: move along x, move along y."""

    model_file = "assets/ant.xml"
    unobserved = 2
    paper_reset_terms = {"alive": 1.0, "energy": 8.0, "vx": 1.0, "vy": 1.0}

    class Options(TaskOptions):
        objectives: Objectives = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0, "energy": 0.5}
        nconmax: int = 8
        njmax: int = 40

    def initial_qpos(self) -> np.ndarray:
        qpos = self.physics.model.qpos0.copy()
        qpos[2] += 0.25  # m
        qpos[8::2] = 0.5, -0.5, -0.5, 0.5  # rad, of the ankles
        return qpos

    def terms(self) -> dict[str, Tensor]:
        vx, vy = self.velocity().unbind(-1)
        return {"alive": torch.ones_like(vx), "energy": 8.0 - self.effort(), "vx": vx, "vy": vy}

    def failed(self) -> Tensor:
        return self.physics.sensor("up")[:, 2] < MIN_UPRIGHT


class Humanoid(Runner):
    """The paper's humanoid: run as fast as possible, use little energy.

    Sensors measure the head, the torso axes, the center of mass and its velocity, so these lag one
    physics step.
    """

    model_file = "assets/humanoid.xml"
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 3.0}

    class Options(RunEnergy):
        nconmax: int = 8
        njmax: int = 53
        extremities: bool = False
        """Observe positions of hands and feet (12 numbers) instead of the paper's three zeros."""

    @cached_property
    def extremities(self) -> list[Tensor]:
        if self.options.extremities:
            return [self.physics.sensor(name) for name in EXTREMITIES]
        return [torch.zeros_like(self.physics.sensor("center"))]

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[2:4] = 1.4, 1.0  # height in m; upright (quaternion w)
        return qpos

    def observe(self) -> Tensor:
        sensor, qpos = self.physics.sensor, self.physics.qpos
        axes = [sensor(f"torso_{axis}")[:, 2:] for axis in "xyz"]
        seen = [qpos[:, 7:], sensor("head")[:, 2:], *self.extremities, *axes, sensor("velocity")]
        return torch.cat([*seen, self.physics.qvel], -1)

    def layout(self) -> list[Part]:
        model = self.physics.model
        if self.options.extremities:
            extremities = [Part(f"position.{name}", 3, "m, from the torso") for name in EXTREMITIES]
        else:
            extremities = [Part("zeros", 3, "")]
        return [
            *positions(model)[4:],
            Part("position.head.z", 1, "m"),
            *extremities,
            *(Part(f"torso.{axis}.z", 1, "world-z of the torso's own axis") for axis in "xyz"),
            Part("velocity.center", 3, "m/s, of the center of mass, in the world"),
            *velocities(model),
        ]

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(ACTION_SCALE * action)

    def place(self) -> Tensor:
        return self.physics.sensor("center")[:, :2]

    def terms(self) -> dict[str, Tensor]:
        speed, action = self.speed(), self.physics.ctrl / ACTION_SCALE
        return {
            "alive": torch.ones_like(speed),
            "run": speed,
            "energy": (3.0 - action.square().sum(-1)).clamp(min=0.0),
        }

    def failed(self) -> Tensor:
        return self.physics.qpos[:, 2] < 0.6
