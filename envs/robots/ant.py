"""Quadruped ant: move along x, move along y."""

import numpy as np
import torch
from torch import Tensor

from ..worlds.environment import Environment
from ..worlds.mujoco_robot import Part, positions, velocities
from ..worlds.options import Objectives, TaskOptions

MIN_UPRIGHT = 0.45  # world-z of the torso's up axis, a tilt of 63 degrees


class Ant(Environment):
    model_file = "assets/ant.xml"
    paper_reset_terms = {"alive": 1.0, "energy": 8.0, "vx": 1.0, "vy": 1.0}

    class Options(TaskOptions):
        objectives: Objectives = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0, "energy": 0.5}
        nconmax: int = 8
        njmax: int = 40

    def initial_qpos(self) -> np.ndarray:
        height, upright = 1.0, [1, 0, 0, 0]
        return np.array([0, 0, height, *upright, 0, 0.5, 0, -0.5, 0, -0.5, 0, 0.5])

    def observe(self) -> Tensor:
        return torch.cat([self.physics.qpos[:, 2:], self.physics.qvel], -1)

    def layout(self) -> list[Part]:
        return [*positions(self.physics.model)[2:], *velocities(self.physics.model)]

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(action.clamp(-1, 1))

    def remember(self) -> dict[str, Tensor]:
        return {"xy": self.physics.qpos[:, :2]}

    def terms(self) -> dict[str, Tensor]:
        velocity = (self.physics.qpos[:, :2] - self.memory["xy"]) / self.dt
        return {
            "alive": torch.ones_like(velocity[:, 0]),
            "energy": 8.0 - self.physics.ctrl.square().sum(-1),
            "vx": velocity[:, 0],
            "vy": velocity[:, 1],
        }

    def failed(self) -> Tensor:
        return self.physics.sensor("up")[:, 2] < MIN_UPRIGHT
