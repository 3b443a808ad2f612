"""Half-cheetah: run fast, use little energy."""

import math

import torch
from torch import Tensor

from ...worlds.options import TaskOptions
from ..gymnasium_robot import GymnasiumRobot

MAX_SPEED = 4.0  # m/s; higher speeds earn no more reward
MAX_PITCH = math.radians(50)


class HalfCheetah(GymnasiumRobot):
    """MO-HalfCheetah-v2."""

    model_file = "half_cheetah.xml"
    substeps = 5

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0}
        nconmax: int = 16
        njmax: int = 64

    def terms(self) -> dict[str, Tensor]:
        speed = self.velocity()[:, 0]
        return {
            "alive": torch.ones_like(speed),
            "run": speed.clamp(max=MAX_SPEED),
            "energy": 4.0 - self.effort(),
        }

    def failed(self) -> Tensor:
        return ~(self.physics.qpos[:, 2].abs() < MAX_PITCH)
