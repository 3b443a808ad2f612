"""The states that episodes start from."""

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from torch import Tensor

from .physics import Physics

NOISY_STARTS = 1024


class Starts(NamedTuple):
    """B initial states and what sensors read in them: B = 1 where every episode starts alike.

    Sensors come from a forward pass that happens here once, so that no reset needs one.
    """

    qpos: Tensor  # (B, nq)
    qvel: Tensor  # (B, nv)
    sensors: Tensor  # (B, nsensordata)

    @classmethod
    def around(cls, qpos: np.ndarray, noise: float, physics: Physics, seed: int) -> "Starts":
        """`qpos` (nq,) at rest, or with `noise` that many different states around it."""
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
        return cls(*(torch.from_numpy(column).to(physics.qpos) for column in columns))

    def draw(self, num_worlds: int, generator: torch.Generator) -> "Starts":
        """One start for each world, or the only one there is, with a single row for all."""
        if len(self.qpos) == 1:
            return self
        chosen = torch.randint(
            len(self.qpos), (num_worlds,), generator=generator, device=self.qpos.device
        )
        return Starts(*(column[chosen] for column in self))
