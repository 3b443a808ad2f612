"""Planar one-legged hopper: run, and jump high."""

import math

import numpy as np
import torch
from torch import Tensor

from ..worlds.options import TaskOptions
from .planar import Planar

ACTION_SCALE = 3.0  # neither actions nor motors clip the result


class Hopper(Planar):
    model_file = "assets/hopper.xml"
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0}

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.5}, "jump": {"jump": 12.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.0002}
        nconmax: int = 2
        njmax: int = 12

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[1] = 1.0  # m; the foot is 0.06 m above the floor
        return qpos

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(ACTION_SCALE * action)

    def terms(self) -> dict[str, Tensor]:
        z = self.physics.qpos[:, 1]
        return {
            "alive": torch.ones_like(z),
            "ctrl_cost": self.physics.ctrl.square().sum(-1),
            "run": self.speed(),
            "jump": (z - 1.0 + 0.2).clamp(min=0.0),
            "upright": (z - 0.4).clamp(-0.2, 0.0),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return (height < 0.2) | (pitch.abs() > math.radians(270))
