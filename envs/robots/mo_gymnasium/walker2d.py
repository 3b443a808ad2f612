"""Planar biped: run fast, use little control."""

from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.options import TaskOptions
from ...worlds.section import Count
from ..gymnasium_robot import GymnasiumRobot


class Walker2d(GymnasiumRobot):
    """mo-walker2d-v5."""

    model_file = "walker2d_v5.xml"
    substeps = 4
    fastest_seen = 10.0

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {
            "run": {"run": 1.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 1.0}
        reference_point: tuple[float, ...] | None = (-100.0, -6000.0)
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.005
        nconmax: int = 16
        njmax: int = 64

    def terms(self) -> dict[str, Tensor]:
        return {
            "healthy": (~self.failed()).to(self.physics.qpos),
            "run": self.velocity()[:, 0],
            "ctrl_cost": self.effort(),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (pitch.abs() < 1.0))
