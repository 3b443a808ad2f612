"""Find the mirror of a robot by an experiment: simulate it beside its mirror image.

The model tells how joints and motors are mirrored, and what both robots observe tells the rest, so
that tasks need not declare it.
"""

import mujoco
import numpy as np
import torch
from mujoco import mjtJoint
from torch import Tensor

from ..errors import MorlaxError
from ..physics.interface import Physics
from .mirror import FLIP, Mirror, Reflection, of_joints
from .robot import Robot

PAIRS, STEPS = 32, 40  # robots beside their images; control steps, in which most of them fall
SPREAD = 0.2  # of the start, in m, rad, m/s and rad/s
ALIKE = 0.1  # mean difference between rewards of robot and image, as a share of their mean
ALMOST = 0.3  # root mean square of the same for observations, since contacts amplify rounding


def find_mirror(worlds: Robot) -> Mirror:
    """Return the mirror of a robot, which `network.symmetric` needs.

    Args:
        worlds: 2 * PAIRS worlds of the robot in C MuJoCo, all alike, without automatic resets.

    Raises:
        MorlaxError: left and right of the robot or of its objectives differ, it has none, or an
            action is not the control of a motor.
    """
    physics = worlds.physics
    assert isinstance(physics, Physics)
    positions, velocities, motors = _of_model(physics.model)
    if worlds.action_size != len(motors.order):
        raise _refused("an action of it is not the control of one motor")
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
    own, image = torch.stack(earned[1:], 1).flatten(1, 2)  # the first is of a sudden move
    for name, one, other in zip(worlds.objectives, own.T, image.T, strict=True):
        if (one - other).abs().mean() > ALIKE * one.abs().mean():
            raise _refused(f"its mirror image has other rewards of the objective {name}")
    observation = _matching(*torch.stack(seen, 1).flatten(1, 2))
    if observation.is_none:
        raise _refused("it has no left and right")
    return Mirror(observation, motors)


def _refused(reason: str) -> MorlaxError:
    return MorlaxError(
        f"this robot cannot be symmetric, since {reason}: set network.symmetric to false, or "
        "override `mirror` in the task."
    )


def _of_model(model: mujoco.MjModel) -> tuple[Reflection, Reflection, Reflection]:
    """Return the reflections of qpos, qvel and ctrl."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = np.flatnonzero(model.jnt_type >= int(mjtJoint.mjJNT_SLIDE))  # and hinges
    found = of_joints(
        data.xanchor[joints],
        data.xaxis[joints],
        model.jnt_type[joints] == mjtJoint.mjJNT_SLIDE,
        [model.joint(joint).name for joint in joints],
    )
    positions, velocities = Reflection.none(model.nq), Reflection.none(model.nv)
    for joint in np.flatnonzero(model.jnt_type == mjtJoint.mjJNT_FREE):
        place, speed = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        positions.sign[place : place + 7] = torch.tensor([*FLIP, 1.0, *-FLIP])
        velocities.sign[speed : speed + 6] = torch.tensor([*FLIP, *-FLIP])
    for reflection, where in ((positions, model.jnt_qposadr), (velocities, model.jnt_dofadr)):
        mine = torch.from_numpy(where[joints]).long()
        reflection.order[mine] = mine[found.order]
        reflection.sign[mine] = found.sign
    return positions, velocities, _of_motors(model, velocities)


def _of_motors(model: mujoco.MjModel, velocities: Reflection) -> Reflection:
    """Return the reflection of ctrl, from that of qvel."""
    if (model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT).any():
        raise _refused("it has actuators that do not move one joint")
    moved = model.jnt_dofadr[model.actuator_trnid[:, 0]].tolist()
    partners = velocities.order[moved].tolist()
    if not set(partners) <= set(moved):
        raise _refused("a joint without a motor mirrors one with a motor")
    return Reflection(
        torch.tensor([moved.index(partner) for partner in partners]), velocities.sign[moved]
    )


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


def _matching(own: Tensor, image: Tensor) -> Reflection:
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
    if (bad := (error[rows, order] > ALMOST**2 * (energy + energy[order]))).any():
        raise _refused(f"number {int(bad.int().argmax())} of its observation has no mirror image")
    return Reflection(order, torch.where(product[rows, order] < 0, -1.0, 1.0).float())
