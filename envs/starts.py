"""The states that episodes start from."""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .physics import Physics

NOISY_STARTS = 1024


class Start(NamedTuple):
    """A state, and what the motors are told in it."""

    qpos: NDArray[np.float64]  # (nq,)
    qvel: NDArray[np.float64]  # (nv,)
    ctrl: NDArray[np.float64]  # (nu,)


class Starts:
    """B initial states and what sensors read in them: B = 1 where every episode starts alike.

    Sensors come from a forward pass that happens here once, so that no reset needs one.

    Args:
        starts: the B states.
        physics: that the episodes will run in.
    """

    def __init__(self, starts: Iterable[Start], physics: Physics):
        data = mujoco.MjData(physics.model)
        rows = []
        for start in starts:
            data.qpos[:], data.qvel[:], data.ctrl[:] = start
            mujoco.mj_forward(physics.model, data)
            rows.append((data.qpos.copy(), data.qvel.copy(), data.sensordata.copy()))
        columns = (np.stack(column) for column in zip(*rows, strict=True))
        self.states = [torch.from_numpy(column).to(physics.qpos) for column in columns]
        self.rows = torch.zeros(physics.num_worlds, dtype=torch.int64, device=physics.device)

    def draw(self, generator: torch.Generator) -> list[Tensor]:
        """A row of the states for each world (N,), and the states: qpos, qvel, sensors (B, ...)."""
        if len(self.states[0]) > 1:
            self.rows.random_(0, len(self.states[0]), generator=generator)
        return [self.rows, *self.states]


def around(
    qpos: NDArray[np.float64], noise: float, model: mujoco.MjModel, seed: int
) -> Iterable[Start]:
    """A state at rest, or with noise many around it.

    Args:
        qpos: (nq,) in their midst.
        noise: their spread; with 0 there is only this one.
    """
    random = np.random.default_rng(seed)
    for _ in range(NOISY_STARTS if noise else 1):
        moved, qvel = qpos.copy(), np.zeros(model.nv)
        if noise:
            mujoco.mj_integratePos(model, moved, random.uniform(-noise, noise, model.nv), 1)
            qvel = noise * random.standard_normal(model.nv)
        yield Start(moved, qvel, np.zeros(model.nu))
