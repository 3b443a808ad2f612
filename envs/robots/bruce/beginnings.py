"""What BRUCE's episodes begin with: a command, a leg to swing first, and a state that fits both."""

from typing import NamedTuple, Self

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...worlds.starts import Start
from . import model as bruce
from .library import Library
from .reference import Reference

FASTEST = (0.2, 0.1)  # m/s, forward and sideways
COMMANDS = 2048  # that episodes choose from
POSITION, ANGLES = slice(16, 19), slice(19, 22)  # of the reference's base, behind 16 joints


class Beginnings(NamedTuple):
    """B of them."""

    commands: Tensor  # (B, 2) m/s, forward and to the left
    legs: Tensor  # (B,) that swing first: 0 left, 1 right
    heights: NDArray[np.float64]  # (B,) how many times as high as at rest to stand

    @classmethod
    def only(cls, command: tuple[float, float]) -> Self:
        """The one at `command`."""
        first = torch.zeros(1, dtype=torch.int64)
        return cls(torch.tensor([command], dtype=torch.float64), first, np.ones(1))

    @classmethod
    def drawn(cls, fastest: tuple[float, float], standing: float, seed: int) -> Self:
        """Many within the limits `fastest`, of which a share is `standing`."""
        random = np.random.default_rng(seed)
        commands = random.uniform(-1, 1, (COMMANDS, 2)) * fastest
        commands[random.random(COMMANDS) < standing] = 0.0
        legs = random.integers(0, 2, COMMANDS)
        heights = random.uniform(1.0, 1.02, COMMANDS)
        return cls(torch.from_numpy(commands), torch.from_numpy(legs), heights)

    def states(
        self, library: Library, rest: NDArray[np.float64], model: mujoco.MjModel
    ) -> tuple[list[Start], Tensor]:
        """The states, and x, y and yaw (B, 3) of the reference in them.

        A walking robot starts as the gait of its command does, a standing one in the default
        pose; `rest` (nq,) is the state of one that stands.
        """
        walk = Reference(library, torch.zeros(len(self.commands), 1, dtype=torch.float64))
        walk.begin(torch.ones(len(self.commands), dtype=torch.bool), self.commands, self.legs)
        walk.elapsed.zero_()
        poses, rates = (t.numpy() for t in walk.now())
        standing = (self.commands == 0).all(-1).numpy()
        anchors = np.zeros((len(standing), 3))
        anchors[standing, :2] = -poses[standing, POSITION][:, :2]
        expand = bruce.joints_from_crank(model)
        starts = []
        for pose, rate, stands, height in zip(poses, rates, standing, self.heights, strict=True):
            qpos, qvel, ctrl = rest.copy(), np.zeros(model.nv), np.zeros(model.nu)
            crank = bruce.DEFAULT_POSE if stands else pose[:16]
            if stands:
                qpos[2] *= height
            else:
                qpos[:3], qpos[7:] = pose[POSITION], expand @ crank
                qvel[:3], qvel[6:] = rate[POSITION], expand @ rate[:16]
            ctrl[:16] = bruce.motors_from_crank() @ crank
            starts.append(Start(qpos, qvel, ctrl))
        return starts, torch.from_numpy(anchors)
