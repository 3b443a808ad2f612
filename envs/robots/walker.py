"""Planar biped: run as fast as possible, use little energy."""

import numpy as np
import torch
from torch import Tensor

from ..worlds.options import TaskOptions
from .planar import Planar

ACTION_SCALE = 3.0


class Walker(Planar):
    model_file = "assets/walker.xml"
    substeps = 2
    paper_reset_terms = {"alive": 1.0, "run": 1.0, "energy": 4.0}

    class Options(TaskOptions):
        objectives: dict[str, dict[str, float]] = {"run": {"run": 1.0}, "energy": {"energy": 1.0}}
        shared: dict[str, float] = {"alive": 1.0}
        nconmax: int = 4
        njmax: int = 22

    def initial_qpos(self) -> np.ndarray:
        qpos = np.zeros(self.physics.model.nq)
        qpos[1] = 1.5  # m; the feet are 0.2 m above the floor
        return qpos

    def apply(self, action: Tensor) -> None:
        self.physics.ctrl.copy_((ACTION_SCALE * action).clamp(-1, 1))

    def terms(self) -> dict[str, Tensor]:
        speed = self.speed()
        return {
            "alive": torch.ones_like(speed),
            "run": speed,
            "energy": 4.0 - self.physics.ctrl.square().sum(-1),
        }

    def failed(self) -> Tensor:
        height, pitch = self.physics.qpos[:, 1], self.physics.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (pitch.abs() < 1.0))
