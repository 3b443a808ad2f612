"""Robots that move in the x-z plane: their base class, the hopper and the walker."""

import math
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from ..worlds.options import Objectives, TaskOptions
from .runner import RunEnergy, Runner

ACTION_SCALE = 3.0


class Planar(Runner):
    """A planar robot: qpos begins with x and z (m) and the pitch (rad) of its torso."""

    fastest_seen = 10.0
    start_height: ClassVar[float] = 0.0  # m, of z

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[1] = self.start_height
        return qpos


class Hopper(Planar):
    """One leg: run, and jump high. Neither actions nor motors clip its control."""

    model_file = "assets/hopper.xml"
    start_height = 1.0  # the foot is 0.06 m above the floor
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0}

    class Options(TaskOptions):
        objectives: Objectives = {"run": {"run": 1.5}, "jump": {"jump": 12.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.0002}
        nconmax: int = 2
        njmax: int = 12

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_(ACTION_SCALE * action)

    def terms(self) -> dict[str, Tensor]:
        z = self.physics.qpos[:, 1]
        return {
            "alive": torch.ones_like(z),
            "ctrl_cost": self.effort(),
            "run": self.speed(),
            "jump": (z - 1.0 + 0.2).clamp(min=0.0),
            "upright": (z - 0.4).clamp(-0.2, 0.0),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return (height < 0.2) | (pitch.abs() > math.radians(270))


class Walker(Planar):
    """Two legs: run as fast as possible, use little energy."""

    model_file = "assets/walker.xml"
    start_height = 1.5  # the feet are 0.2 m above the floor
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 4.0}

    class Options(RunEnergy):
        nconmax: int = 4
        njmax: int = 22

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_((ACTION_SCALE * action).clamp(-1, 1))

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (pitch.abs() < 1.0))
