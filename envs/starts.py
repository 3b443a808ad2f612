"""The states that episodes start from."""

import mujoco
import numpy as np
import torch
from torch import Tensor

from .physics import Physics

NOISY_STARTS = 1024


class Starts:
    """B initial states and what sensors read in them: B = 1 where every episode starts alike.

    Sensors come from a forward pass that happens here once, so that no reset needs one.

    Args:
        qpos: (nq,) an episode starts from, at rest.
        noise: spread of the states around it; with 0 there is only this one.
        physics: that the episodes will run in.
        seed: of the states.
    """

    def __init__(self, qpos: np.ndarray, noise: float, physics: Physics, seed: int):
        model, random = physics.model, np.random.default_rng(seed)
        data = mujoco.MjData(model)
        rows = []
        for _ in range(NOISY_STARTS if noise else 1):
            data.qpos[:] = qpos
            if noise:
                mujoco.mj_integratePos(model, data.qpos, random.uniform(-noise, noise, model.nv), 1)
                data.qvel[:] = noise * random.standard_normal(model.nv)
            mujoco.mj_forward(model, data)
            rows.append((data.qpos.copy(), data.qvel.copy(), data.sensordata.copy()))
        columns = (np.stack(column) for column in zip(*rows, strict=True))
        self.states = [torch.from_numpy(column).to(physics.qpos) for column in columns]
        self._rows = torch.zeros(physics.num_worlds, dtype=torch.int64, device=physics.device)

    def draw(self, generator: torch.Generator) -> list[Tensor]:
        """A row of the states for each world (N,), and the states: qpos, qvel, sensors (B, ...)."""
        if len(self.states[0]) > 1:
            self._rows.random_(0, len(self.states[0]), generator=generator)
        return [self._rows, *self.states]
