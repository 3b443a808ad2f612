"""Planar one-legged hopper: run, jump high and, with three objectives, use little control."""

from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.options import TaskOptions
from ...worlds.section import Count
from ..gymnasium_robot import GymnasiumRobot

STANDING = 1.25  # m


class Hopper(GymnasiumRobot):
    """mo-hopper-v5."""

    model_file = "hopper.xml"
    substeps = 4
    fastest_seen = 10.0

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {
            "run": {"run": 1.0},
            "jump": {"jump": 10.0},
            "control": {"ctrl_cost": -1.0},
        }
        shared: dict[str, float] = {"healthy": 1.0}
        reference_point: tuple[float, ...] | None = (-100.0, -100.0, -3000.0)
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.005
        nconmax: int = 12
        njmax: int = 40

    def terms(self) -> dict[str, Tensor]:
        return {
            "healthy": (~self.failed()).to(self.physics.qpos),
            "run": self.velocity()[:, 0],
            "jump": self.physics.qpos[:, 1] - STANDING,
            "ctrl_cost": self.effort(),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        farthest = self.physics.qpos[:, 2:].abs().amax(-1)
        fastest = self.physics.qvel.abs().amax(-1)
        return ~((height > 0.7) & (pitch.abs() < 0.2) & (farthest < 100) & (fastest < 100))


class Hopper2(Hopper):
    """mo-hopper-2obj-v5: control is a small cost instead of an objective."""

    class Options(Hopper.Options):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "jump": {"jump": 10.0}}
        shared: dict[str, float] = {"healthy": 1.0, "ctrl_cost": -0.001}
        reference_point: tuple[float, ...] | None = (-100.0, -100.0)
