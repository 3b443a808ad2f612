"""Humanoid: run fast, spend little energy."""

import torch
from pydantic import NonNegativeFloat, PositiveInt
from torch import Tensor

from ..gymnasium_humanoid import GymnasiumHumanoid, HumanoidOptions


class Humanoid(GymnasiumHumanoid):
    """MO-Humanoid-v2, which alone of the seven has episodes of 1000 steps and noisy starts.

    The observation leaves out what was always zero: the rows of the world itself, and the motors
    of the floating base. An action counts as clipped to the motors' range for its energy, too.
    """

    class Options(HumanoidOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.25}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 3.0}
        episode_length: PositiveInt = 1000
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
