"""Three links in a viscous fluid: swim fast, use little control."""

from pydantic import NonNegativeFloat
from torch import Tensor

from ...worlds.options import TaskOptions
from ...worlds.section import Count
from ..gymnasium_robot import GymnasiumRobot


class Swimmer(GymnasiumRobot):
    """mo-swimmer-v5. The robot never fails."""

    model_file = "swimmer.xml"
    substeps = 4
    unobserved = 2

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {
            "run": {"run": 1.0},
            "control": {"ctrl_cost": -1.0},
        }
        reference_point: tuple[float, ...] | None = (-100.0, -2000.0)
        episode_length: Count = 1000
        reset_noise: NonNegativeFloat = 0.1
        nconmax: int = 1
        njmax: int = 4

    def terms(self) -> dict[str, Tensor]:
        return {"run": self.velocity()[:, 0], "ctrl_cost": self.effort()}
