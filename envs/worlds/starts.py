"""The states that episodes start from."""

from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..devices import Draws
from ..physics.interface import Physics

NOISY_STARTS = 1024


class Start(NamedTuple):
    """An initial state and its control."""

    qpos: NDArray[np.float64]  # (nq,)
    qvel: NDArray[np.float64]  # (nv,)
    ctrl: NDArray[np.float64]  # (nu,)


class Starts:
    """B initial states with their sensor readings; B = 1 if every episode starts alike.

    One forward pass here computes the sensor readings, so that no reset needs one.

    Args:
        starts: the B states.
        physics: the physics that episodes run in.
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

    def draw(self, draws: Draws) -> list[Tensor]:
        """Draw a row for each world; returns rows (N,) and qpos, qvel and sensors (B, ...)."""
        if len(self.states[0]) > 1:
            draws.integers_(self.rows, 0, len(self.states[0]))
        return [self.rows, *self.states]


def around(
    qpos: NDArray[np.float64], noise: float, model: mujoco.MjModel, seed: int
) -> Iterable[Start]:
    """Yield one state at rest, or with noise NOISY_STARTS states around it.

    Args:
        qpos: (nq,) the positions at rest.
        noise: half the width of uniform noise on positions (m, rad) and the standard deviation of
            noise on velocities (m/s, rad/s).
        model: the robot.
        seed: random seed of the noise.
    """
    random = np.random.default_rng(seed)
    for _ in range(NOISY_STARTS if noise else 1):
        moved, qvel = qpos.copy(), np.zeros(model.nv)
        if noise:
            mujoco.mj_integratePos(model, moved, random.uniform(-noise, noise, model.nv), 1)
            qvel = noise * random.standard_normal(model.nv)
        yield Start(moved, qvel, np.zeros(model.nu))
