"""Quadruped ant: move along x, move along y."""

import mujoco
import torch
from torch import Tensor

from ...worlds.options import TaskOptions
from ..gymnasium_robot import GymnasiumRobot


class Ant(GymnasiumRobot):
    """MO-Ant-v2. The robot never fails, not even on its back.

    Velocity is computed from `qpos`. The original uses the torso's body position, which the RK4
    integrator leaves at its last stage.
    """

    model_file = "ant.xml"
    substeps = 5
    unobserved = 2

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"vx": {"vx": 1.0}, "vy": {"vy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0, "ctrl_cost": -0.5}
        nconmax: int = 32
        njmax: int = 136

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for actuator in spec.actuators:
            actuator.gear[0] = 100.0

    def terms(self) -> dict[str, Tensor]:
        vx, vy = self.velocity().unbind(-1)
        return {"alive": torch.ones_like(vx), "ctrl_cost": self.effort(), "vx": vx, "vy": vy}
