"""Initial conditions of BRUCE's episodes: a command, the first swing leg, a matching state."""

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...worlds.episodes import Start
from . import model as bruce
from .reference import JOINTS, POSITION, Library, Reference

FASTEST = (0.2, 0.1)  # largest commands, m/s, forward and sideways
COMMANDS = 2048  # number of commands that episodes draw from
Array = NDArray[np.float64]
# Commands (B, 2), first legs (B,), and heights (B,) of standing robots, relative to rest.
Conditions = tuple[Array, NDArray[np.int64], Array]


class TaskState(NamedTuple):
    """Initial task state besides the physics; one row per initial condition or world."""

    command: Tensor  # (B, 2) m/s, forward and to the left
    leg: Tensor  # (B,) first swing leg: 0 left, 1 right
    anchor: Tensor  # (B, 3) pose of the reference: x, y (m) and yaw (rad)
    points: Tensor  # (B, 8, 22) control points of the first step
    target: Tensor  # (B, 23) of the reference
    rates: Tensor  # (B, 22) of the reference


def drawn_commands(fastest: tuple[float, float], standing: float, seed: int) -> Conditions:
    """Draw COMMANDS initial conditions.

    `fastest` limits the commands, in m/s; `standing` is the probability of a zero one.
    """
    random = np.random.default_rng(seed)
    commands = random.uniform(-1, 1, (COMMANDS, 2)) * fastest
    commands[random.random(COMMANDS) < standing] = 0.0
    return commands, random.integers(0, 2, COMMANDS), random.uniform(1.0, 1.02, COMMANDS)


def states(
    library: Library,
    conditions: Conditions,
    rest: Array,
    model: mujoco.MjModel,
    like: Tensor,
) -> tuple[list[Start], TaskState]:
    """Return the B initial states with their task states, of the dtype and device of `like`.

    A walking robot starts in the first state of its command's gait, a standing robot in the
    default pose, with positions `rest` (nq,).
    """
    commands, legs, heights = conditions

    def begun(like: Tensor) -> Reference:
        velocity, leg = torch.from_numpy(commands).to(like), torch.from_numpy(legs).to(like.device)
        walk, everywhere = Reference(library, velocity), torch.ones_like(leg, dtype=torch.bool)
        walk.begin(everywhere, velocity, leg, walk.gaits(velocity, leg))
        return walk

    walk = begun(torch.from_numpy(commands))
    walk.elapsed.zero_()
    poses, rates = (t.numpy() for t in walk.now())
    standing = (commands == 0).all(-1)
    anchors = np.zeros((len(standing), 3))
    anchors[standing, :2] = -poses[standing, POSITION][:, :2]
    expand = bruce.joints_from_crank(model)
    starts = []
    for pose, rate, stands, height in zip(poses, rates, standing, heights, strict=True):
        qpos, qvel, ctrl = rest.copy(), np.zeros(model.nv), np.zeros(model.nu)
        crank = bruce.DEFAULT_POSE if stands else pose[JOINTS]
        if stands:
            qpos[2] *= height
        else:
            qpos[:3], qpos[7:] = pose[POSITION], expand @ crank
            qvel[:3], qvel[6:] = rate[POSITION], expand @ rate[JOINTS]
        ctrl[:16] = bruce.motors_from_crank() @ crank
        starts.append(Start(qpos, qvel, ctrl))
    walk, anchor = begun(like), torch.from_numpy(anchors).to(like)
    return starts, TaskState(walk.velocity, walk.leg, anchor, walk.points, *walk.now())
