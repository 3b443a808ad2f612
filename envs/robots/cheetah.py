"""Half-cheetah: run fast, use little energy and, with three objectives, keep the torso high."""

import math

import torch
from torch import Tensor

from ..worlds.options import Objectives, TaskOptions
from .planar import Planar

MAX_SPEED = 4.0  # m/s; higher speeds earn no more reward
MAX_PITCH = math.radians(50)


class Cheetah(Planar):
    model_file = "assets/cheetah.xml"
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 4.0, "height": 0.2}

    class Options(TaskOptions):
        objectives: Objectives = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0}
        nconmax: int = 16
        njmax: int = 72

    def terms(self) -> dict[str, Tensor]:
        z = self.physics.qpos[:, 1]
        return {
            "alive": torch.ones_like(z),
            "run": self.speed().clamp(max=MAX_SPEED),
            "energy": 4.0 - self.effort(),
            "height": z + 0.2,
        }

    def failed(self) -> Tensor:
        return ~(self.physics.qpos[:, 2].abs() < MAX_PITCH)


class Cheetah3(Cheetah):
    class Options(Cheetah.Options):
        objectives: Objectives = {
            "run": {"run": 1.0},
            "energy": {"energy": 1.0},
            "height": {"height": 10.0},
        }
