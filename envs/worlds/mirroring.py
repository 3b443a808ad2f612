"""Find the mirror of a robot by an experiment: simulate it beside its mirror image.

The model tells how joints and motors are mirrored, and what both robots observe tells the rest, so
that tasks need not declare it.
"""

import mujoco
import torch
from torch import Tensor

from ..physics.interface import Physics
from ..physics.mujoco import MujocoPhysics
from . import sides
from .mirror import Mirror, Reflection
from .robot import Robot

PAIRS, STEPS = 32, 40  # robots beside their images; control steps, in which most of them fall
SETTLE = 10  # of these steps, after which observations that hold earlier states are compared
SPREAD = 0.2  # of the start, in m, rad, m/s and rad/s
# Shares of their size by which rewards and observations of robot and image may differ, in the mean
# and in the median, and what is added. MuJoCo finds contacts of meshes one after another, and its
# PGS solver finds forces so, in another order for an image.
EXACT, USUAL, TINY = 0.01, 1e-4, 1e-7
ALIKE, ALMOST = 0.1, 0.3  # in the mean, of rewards and observations, where a tolerance is given


def find_mirror(worlds: Robot, tolerance: float = 0.0) -> Mirror:
    """Return the mirror of a robot, which `network.symmetric` needs.

    Args:
        worlds: 2 * PAIRS worlds of the robot in C MuJoCo, all alike, without automatic resets.
        tolerance: largest difference between numbers of left and right, see `sides.check`.

    Raises:
        MorlaxError: left and right of the robot or of its objectives differ, it has none, or an
            action is not the control of a motor.
    """
    physics = worlds.physics
    assert isinstance(physics, MujocoPhysics)
    motion = positions, velocities, motors = sides.motion_of(physics.model)
    if worlds.action_size != len(motors.order):
        raise sides.cannot("an action of it is not the control of one motor")
    sides.check(physics.model_of(0), motion, tolerance)
    generator = torch.Generator().manual_seed(0)
    _scatter(physics, generator)
    seen, earned = [], []
    for _ in range(STEPS):
        draws = torch.rand(PAIRS, worlds.action_size, generator=generator, dtype=torch.float32)
        action = 2 * draws - 1
        _copy_into_mirror(physics, positions, velocities)  # or chaos would part them
        step = worlds.step(torch.cat([action, motors(action)]))
        seen.append(step.final_critic_observation.unflatten(0, (2, PAIRS)))
        earned.append(step.reward.unflatten(0, (2, PAIRS)))
    ours, image = torch.stack(earned[SETTLE:], 1).flatten(1, 2)
    apart, size = (ours - image).abs(), ours.abs().mean(0)
    far = apart.mean(0) > ALIKE * size if tolerance else _far(apart, size)
    for name in (name for name, each in zip(worlds.objectives, far, strict=True) if each):
        raise sides.cannot(f"its mirror image has other rewards of the objective {name}")
    observation = _matching(*torch.stack(seen[SETTLE:], 1).flatten(1, 2), exact=not tolerance)
    if observation.is_none:
        raise sides.cannot("it has no left and right")
    return Mirror(observation, motors)


def _far(apart: Tensor, size: Tensor) -> Tensor:
    """Return (c,) bool: whether differences (n, c) are more than inexact contacts cause."""
    typical = apart.median(0).values
    return (apart.mean(0) > EXACT * size + TINY) | (typical > USUAL * size + TINY)


def _scatter(physics: Physics, generator: torch.Generator) -> None:
    """Move the first half of the worlds at random."""
    shape = 2, PAIRS, physics.model.nv
    draws = torch.rand(*shape, generator=generator, dtype=torch.float32).to(physics.qpos)
    shift, speed = SPREAD * (2 * draws - 1)
    for start, change in zip(physics.qpos.numpy(), shift.numpy(), strict=False):
        mujoco.mj_integratePos(physics.model, start, change, 1.0)
    physics.qvel[:PAIRS] = speed


def _copy_into_mirror(physics: Physics, positions: Reflection, velocities: Reflection) -> None:
    """Make the second half of the worlds the mirror images of the first."""
    pairs = (physics.qpos, positions), (physics.qvel, velocities), (physics.warmstart, velocities)
    for values, reflection in pairs:
        values[PAIRS:] = reflection(values[:PAIRS])


def _matching(own: Tensor, image: Tensor, *, exact: bool) -> Reflection:
    """Return the reflection of features (n, S) that explains what the images saw, (n, S).

    Raises:
        MorlaxError: no reflection does.
    """
    own, image = own.double(), image.double()
    energy, product = own.square().mean(0), image.T @ own / len(own)
    error = image.square().mean(0)[:, None] + energy - 2 * product.abs()  # of the better sign
    error.diagonal().sub_(1e-9 * (1 + energy))  # what is always zero, or the same, stays in place
    error = error + error.T
    order, rows = torch.full_like(energy, -1).long(), torch.arange(len(energy))
    for row in rows.tolist():
        if order[row] < 0:  # of several that are always equal, each gets one
            partner = int(error[row].masked_fill(order >= 0, torch.inf).argmin())
            order[row], order[partner] = partner, row
    sign = torch.where(product[rows, order] < 0, -1.0, 1.0).float()
    if exact:
        far = _far((image - own[:, order] * sign).abs(), energy[order].sqrt())
    else:
        far = error[rows, order] > ALMOST**2 * (energy + energy[order])
    if far.any():
        number = int(far.int().argmax())
        raise sides.cannot(f"number {number} of its observation has no mirror image")
    return Reflection(order, sign)
