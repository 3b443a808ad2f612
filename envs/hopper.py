"""Planar one-legged hopper: run, and jump high."""

import math

import numpy as np
import torch
from torch import Tensor

from .environment import Environment
from .layout import Part, positions, velocities
from .options import TaskOptions

ACTION_SCALE = 3.0  # neither clipped here nor clamped by the motors
MAX_VELOCITY = 10.0  # m/s, rad/s; what is faster looks like this


class Hopper(Environment):
    model_file = "hopper.xml"
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0}

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.5}, "jump": {"jump": 12.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.0002}
        nconmax: int = 2
        njmax: int = 12

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[1] = 1.0  # metres: the foot hangs 0.06 above the floor
        return qpos

    def observe(self) -> Tensor:
        limit = MAX_VELOCITY
        return torch.cat([self.physics.qpos[:, 1:], self.physics.qvel.clamp(-limit, limit)], -1)

    def layout(self) -> list[Part]:
        model = self.physics.model
        return [*positions(model)[1:], *velocities(model, MAX_VELOCITY)]

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(ACTION_SCALE * action)

    def remember(self) -> dict[str, Tensor]:
        return {"x": self.physics.qpos[:, 0]}

    def terms(self) -> dict[str, Tensor]:
        x, z = self.physics.qpos[:, 0], self.physics.qpos[:, 1]
        return {
            "alive": torch.ones_like(x),
            "ctrl_cost": self.physics.ctrl.square().sum(-1),
            "run": (x - self.memory["x"]) / self.dt,
            "jump": (z - 1.0 + 0.2).clamp(min=0.0),
            "upright": (z - 0.4).clamp(-0.2, 0.0),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return (height < 0.2) | (pitch.abs() > math.radians(270))
