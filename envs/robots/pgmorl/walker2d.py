"""Planar biped: run fast, use little energy."""

import mujoco
import torch
from torch import Tensor

from ...worlds.options import TaskOptions
from ..gymnasium_robot import GymnasiumRobot


class Walker2d(GymnasiumRobot):
    """MO-Walker2d-v2."""

    model_file = "walker2d.xml"
    substeps = 4
    fastest_seen = 10.0

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0}
        nconmax: int = 16
        njmax: int = 64

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for joint in spec.joints[3:]:
            joint.damping[0] = 3.0
        for geom in spec.geoms:
            geom.density = 1500.0  # kg/m^3

    def terms(self) -> dict[str, Tensor]:
        speed = self.velocity()[:, 0]
        return {"alive": torch.ones_like(speed), "run": speed, "energy": 4.0 - self.effort()}

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (pitch.abs() < 1.0))
