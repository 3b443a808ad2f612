"""A model at rest, and the robot among its kinematic trees. `morlax play` needs no torch here."""

import mujoco
import numpy as np
from mujoco import mjtJoint
from numpy.typing import ArrayLike

from ..errors import unknown

LEVEL = 1e-6  # upward part of a direction along the floor


def base_of(model: mujoco.MjModel, name: str | None = None) -> int:
    """Return the robot's base: the first body of its kinematic tree, which pushes move.

    The `name` of a body decides which tree. By default, it is the one that the most actuators act
    on; of several, the one with the most degrees of freedom, then the first one.
    """
    trees = model.body_treeid  # -1: cannot move
    if name is not None:
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        if body < 0:
            raise unknown("body", name, [model.body(i).name for i in range(model.nbody)])
        return int(np.flatnonzero(trees == trees[body])[0]) if trees[body] >= 0 else body
    if not model.ntree:
        return min(1, model.nbody - 1)
    data = forwarded(model)
    counts = np.zeros(model.ntree, int)  # of the actuators that act on each tree
    for start, number in zip(data.moment_rowadr, data.moment_rownnz, strict=True):
        dofs = data.moment_colind[start : start + number]
        counts[np.unique(model.dof_treeid[dofs])] += 1
    freedoms = np.bincount(model.dof_treeid, minlength=model.ntree)
    robot = max(range(model.ntree), key=lambda tree: (counts[tree], freedoms[tree], -tree))
    return int(np.flatnonzero(trees == robot)[0])


def forwarded(model: mujoco.MjModel, qpos: ArrayLike | None = None) -> mujoco.MjData:
    """Return the data of a model at rest at positions (nq,), by default its own."""
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def horizontal(model: mujoco.MjModel, base: int) -> list[int]:
    """Return the degrees of freedom that move the base along the floor."""
    data, dofs = forwarded(model), []
    for joint in np.flatnonzero(model.jnt_bodyid == base):
        kind, dof = model.jnt_type[joint], int(model.jnt_dofadr[joint])
        if kind == mjtJoint.mjJNT_FREE:
            return [dof, dof + 1]
        if kind == mjtJoint.mjJNT_SLIDE and abs(data.xaxis[joint, 2]) < LEVEL:
            dofs.append(dof)
    return dofs
