"""Initial conditions of BRUCE's episodes: a command, the first swing leg, a matching state."""

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

FASTEST = (0.2, 0.1)  # largest commands, m/s, forward and sideways
COMMANDS = 2048  # number of commands that episodes draw from
POSITION, ANGLES = slice(16, 19), slice(19, 22)  # of the reference's base, after 16 joints


class Beginnings(NamedTuple):
    """B initial conditions."""

    commands: Tensor  # (B, 2) m/s, forward and to the left
    legs: Tensor  # (B,) first swing leg: 0 left, 1 right
    heights: NDArray[np.float64]  # (B,) initial height of a standing robot, relative to rest

    @classmethod
    def only(cls, command: tuple[float, float]) -> Self:
        """Return one initial condition, with `command` (m/s) and the left leg swinging first."""
        first = torch.zeros(1, dtype=torch.int64)
        return cls(torch.tensor([command], dtype=torch.float64), first, np.ones(1))

    @classmethod
    def drawn(cls, fastest: tuple[float, float], standing: float, seed: int) -> Self:
        """Draw COMMANDS initial conditions.

        Args:
            fastest: limits of the commands in m/s, forward and sideways.
            standing: probability of a zero command.
            seed: random seed.
        """
        random = np.random.default_rng(seed)
        commands = random.uniform(-1, 1, (COMMANDS, 2)) * fastest
        commands[random.random(COMMANDS) < standing] = 0.0
        legs = random.integers(0, 2, COMMANDS)
        heights = random.uniform(1.0, 1.02, COMMANDS)
        return cls(torch.from_numpy(commands), torch.from_numpy(legs), heights)

    def states(
        self, library: Library, rest: NDArray[np.float64], model: mujoco.MjModel
    ) -> tuple[list[Start], Tensor]:
        """Return the initial states.

        A walking robot starts in the first state of its command's gait, a standing robot in the
        default pose.

        Args:
            library: the gaits.
            rest: (nq,) positions of a standing robot.
            model: the robot.

        Returns:
            B states, and the pose of the reference in each: x, y (m) and yaw (rad), (B, 3).
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
