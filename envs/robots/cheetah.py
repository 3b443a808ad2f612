"""Half-cheetah: run fast, use little energy and, with three objectives, keep the torso high."""

import math

from torch import Tensor

from ..worlds.options import Objectives
from .planar import Planar
from .runner import RunEnergy

MAX_SPEED = 4.0  # m/s; higher speeds earn no more reward
MAX_PITCH = math.radians(50)


class Cheetah(Planar):
    model_file = "assets/cheetah.xml"
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 4.0, "height": 0.2}

    class Options(RunEnergy):
        njmax: int = 72

    def terms(self) -> dict[str, Tensor]:
        terms, z = super().terms(), self.physics.qpos[:, 1]
        return {**terms, "run": terms["run"].clamp(max=MAX_SPEED), "height": z + 0.2}

    def failed(self) -> Tensor:
        return ~(self.physics.qpos[:, 2].abs() < MAX_PITCH)


class Cheetah3(Cheetah):
    class Options(Cheetah.Options):
        objectives: Objectives = {
            "run": {"run": 1.0},
            "energy": {"energy": 1.0},
            "height": {"height": 10.0},
        }
