"""Humanoid: run fast, use little control."""

from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.section import Count
from ..gymnasium_humanoid import GymnasiumHumanoid, HumanoidOptions


class Humanoid(GymnasiumHumanoid):
    """mo-humanoid-v5."""

    class Options(HumanoidOptions):
        objectives: dict[str, dict[str, float]] = {
            "run": {"run": 1.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 5.0, "contact_cost": -1.0}
        reference_point: tuple[float, ...] | None = (-100.0, -2720.0)
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.01

    def terms(self) -> dict[str, Tensor]:
        contact = self.bodies.contact_forces().square().sum((1, 2))
        return {
            "healthy": (~self.failed()).to(self.physics.qpos),
            "contact_cost": (5e-7 * contact).clamp(max=10.0),
            "run": self.velocity()[:, 0],
            "ctrl_cost": self.effort(),
        }

    def failed(self) -> Tensor:
        height = self.physics.qpos[:, 2]
        return ~((height > 1.0) & (height < 2.0))
