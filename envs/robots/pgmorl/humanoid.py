"""Humanoid: run fast, use little energy."""

import torch
from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.section import Count
from ..gymnasium_humanoid import GymnasiumHumanoid, HumanoidOptions


class Humanoid(GymnasiumHumanoid):
    """MO-Humanoid-v2, the only one of the seven with 1000-step episodes and noisy starts.

    The observation omits entries that are always zero: those of the world body and the motor forces
    on the floating base. The energy term uses the action clipped to the motors' control range.
    """

    class Options(HumanoidOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.25}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 3.0}
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.01

    def terms(self) -> dict[str, Tensor]:
        speed = self.velocity()[:, 0]
        return {
            "alive": torch.ones_like(speed),
            "run": speed,
            "energy": 3.0 - 4.0 * self.effort(),
        }

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return (height < 1.0) | (height > 2.0)
