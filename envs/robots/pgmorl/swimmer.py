"""Three links in a viscous fluid: swim fast, use little energy."""

import mujoco
from torch import Tensor

from ...worlds.options import TaskOptions
from ..gymnasium_robot import GymnasiumRobot


class Swimmer(GymnasiumRobot):
    """MO-Swimmer-v2."""

    model_file = "swimmer.xml"
    substeps = 4
    unobserved = 2

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "energy": {"energy": 0.15}}
        nconmax: int = 1
        njmax: int = 4

    @classmethod
    def edit(cls, spec: mujoco.MjSpec) -> None:
        for actuator in spec.actuators:
            actuator.gear[0] = 300.0

    def terms(self) -> dict[str, Tensor]:
        return {"run": self.velocity()[:, 0], "energy": 2.0 - self.effort()}
