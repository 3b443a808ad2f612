"""Initial conditions of BRUCE's episodes: a command, the first swing leg, a matching state."""

from typing import NamedTuple, Self

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...worlds.episodes import Start
from . import model as bruce
from .gaits import Library
from .reference import JOINTS, POSITION, Reference

FASTEST = (0.2, 0.1)  # largest commands, m/s, forward and sideways
COMMANDS = 2048  # number of commands that episodes draw from


class TaskState(NamedTuple):
    """Initial task state besides the physics; one row per initial condition or world."""

    command: Tensor  # (B, 2) m/s, forward and to the left
    leg: Tensor  # (B,) first swing leg: 0 left, 1 right
    anchor: Tensor  # (B, 3) pose of the reference: x, y (m) and yaw (rad)
    points: Tensor  # (B, 8, 22) control points of the first step
    target: Tensor  # (B, 23) of the reference
    rates: Tensor  # (B, 22) of the reference

    def at(self, rows: Tensor) -> Self:
        """Return the given rows (N,)."""
        return type(self)(*(values[rows] for values in self))


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

        `fastest` limits the commands, in m/s; `standing` is the probability of a zero one.
        """
        random = np.random.default_rng(seed)
        commands = random.uniform(-1, 1, (COMMANDS, 2)) * fastest
        commands[random.random(COMMANDS) < standing] = 0.0
        legs = random.integers(0, 2, COMMANDS)
        heights = random.uniform(1.0, 1.02, COMMANDS)
        return cls(torch.from_numpy(commands), torch.from_numpy(legs), heights)

    def states(
        self, library: Library, rest: NDArray[np.float64], model: mujoco.MjModel, like: Tensor
    ) -> tuple[list[Start], TaskState]:
        """Return the B initial states with their task states, of the dtype and device of `like`.

        A walking robot starts in the first state of its command's gait, a standing robot in the
        default pose, with positions `rest` (nq,).
        """
        walk = self._walk(library, self.commands)
        walk.elapsed.zero_()
        poses, rates = (t.numpy() for t in walk.now())
        standing = (self.commands == 0).all(-1).numpy()
        anchors = np.zeros((len(standing), 3))
        anchors[standing, :2] = -poses[standing, POSITION][:, :2]
        expand = bruce.joints_from_crank(model)
        starts = []
        for pose, rate, stands, height in zip(poses, rates, standing, self.heights, strict=True):
            qpos, qvel, ctrl = rest.copy(), np.zeros(model.nv), np.zeros(model.nu)
            crank = bruce.DEFAULT_POSE if stands else pose[JOINTS]
            if stands:
                qpos[2] *= height
            else:
                qpos[:3], qpos[7:] = pose[POSITION], expand @ crank
                qvel[:3], qvel[6:] = rate[POSITION], expand @ rate[JOINTS]
            ctrl[:16] = bruce.motors_from_crank() @ crank
            starts.append(Start(qpos, qvel, ctrl))
        walk, anchor = self._walk(library, like), torch.from_numpy(anchors).to(like)
        return starts, TaskState(walk.velocity, walk.leg, anchor, walk.points, *walk.now())

    def _walk(self, library: Library, like: Tensor) -> Reference:
        """Return the reference walk of each initial condition, at its start."""
        velocity, leg = self.commands.to(like), self.legs.to(like.device)
        walk, everywhere = Reference(library, velocity), torch.ones_like(leg, dtype=torch.bool)
        walk.begin(everywhere, velocity, leg, walk.gaits(velocity, leg))
        return walk
