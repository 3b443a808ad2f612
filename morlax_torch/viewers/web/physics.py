"""One world of C MuJoCo in float32, to trace a task in."""

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...envs.physics.interface import Physics

ARRAYS = {  # of `Physics`, and their names in mjData
    "qpos": "qpos",
    "qvel": "qvel",
    "act": "act",
    "ctrl": "ctrl",
    "warmstart": "qacc_warmstart",
    "sensors": "sensordata",
}


class PagePhysics(Physics):
    """One world whose tensors are float32, as in training, while MuJoCo computes in float64.

    Browsers run every operation in float32, but not all of them in float64. `vary` is ignored,
    because the page shows the robot of the MJCF.
    """

    name = "C MuJoCo"

    def __init__(self, model: mujoco.MjModel, substeps: int):
        self.model, self.num_worlds, self.device = model, 1, torch.device("cpu")
        self.substeps, self._data = substeps, mujoco.MjData(model)
        self._no_overflow = torch.zeros(1, dtype=torch.int32)
        for name, field in ARRAYS.items():
            setattr(self, name, torch.zeros(1, len(getattr(self._data, field))))

    @property
    def arrays(self) -> dict[str, Tensor]:
        """All tensors (1, ...), by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def step(self) -> None:
        for name, field in ARRAYS.items():
            getattr(self._data, field)[:] = getattr(self, name)[0].numpy()
        mujoco.mj_step(self.model, self._data, self.substeps)
        for name, field in ARRAYS.items():
            getattr(self, name)[0] = torch.from_numpy(getattr(self._data, field))

    def vary(self, fields: dict[str, np.ndarray]) -> None:
        pass

    def overflow(self) -> Tensor:
        return self._no_overflow

    def remedy(self, bits: int) -> str:
        return ""
