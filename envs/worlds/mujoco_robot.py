"""A MuJoCo robot for viewers, films and exports, and the names of what it observes."""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple, Protocol

import mujoco
import numpy as np
from mujoco import mjtJoint
from torch import Tensor

from ..errors import unknown
from .interface import Worlds

LEVEL = 1e-6  # upward part of a direction along the floor


class Part(NamedTuple):
    """Consecutive numbers of an observation."""

    name: str
    size: int
    unit: str


def positions(model: mujoco.MjModel) -> list[Part]:
    """Name the parts of `qpos`, joint by joint."""
    parts = []
    for index, kind in enumerate(model.jnt_type.tolist()):
        name = f"position.{model.joint(index).name}"
        if kind == mjtJoint.mjJNT_FREE:
            parts += [Part(f"{name}.{axis}", 1, "m") for axis in "xyz"]
        if kind in (mjtJoint.mjJNT_FREE, mjtJoint.mjJNT_BALL):
            parts.append(Part(f"{name}.quaternion", 4, "w, x, y, z"))
        else:
            parts.append(Part(name, 1, "m" if kind == mjtJoint.mjJNT_SLIDE else "rad"))
    return parts


def velocities(model: mujoco.MjModel, limit: float | None = None) -> list[Part]:
    """Name the parts of `qvel`, clipped to [-limit, limit] if there is a limit."""
    clipped = "" if limit is None else f", clipped to [{-limit:g}, {limit:g}]"
    parts = []
    for index, kind in enumerate(model.jnt_type.tolist()):
        name = f"velocity.{model.joint(index).name}"
        if kind == mjtJoint.mjJNT_FREE:
            parts.append(Part(f"{name}.linear", 3, "m/s, in the world" + clipped))
        if kind in (mjtJoint.mjJNT_FREE, mjtJoint.mjJNT_BALL):
            parts.append(Part(f"{name}.angular", 3, "rad/s, in the body" + clipped))
        else:
            unit = "m/s" if kind == mjtJoint.mjJNT_SLIDE else "rad/s"
            parts.append(Part(name, 1, unit + clipped))
    return parts


class Deployment(NamedTuple):
    """What a controller needs beside a policy to drive the robot."""

    settings: dict[str, Any]  # plain values in the shape of unitree_rl_lab's deploy.yaml
    model: bytes | None  # a zip of robot.xml and the files that it names, if it can be written


class State(Protocol):
    """A model, and the state of N worlds of it. Write to the state to move a robot."""

    model: mujoco.MjModel
    qpos: Tensor  # (N, nq)
    qvel: Tensor  # (N, nv)
    ctrl: Tensor  # (N, nu)
    act: Tensor  # (N, na)


class Robot(Worlds):
    """N worlds of a robot whose MuJoCo model is known."""

    physics: State
    # Name of a body of the robot that pushes move and cameras follow, in a scene where others move
    # too; None: that of the kinematic tree with the most actuators.
    base_body: ClassVar[str | None] = None
    # Limits of each number of `command` (N, C), such as a velocity, by name. Anyone may write
    # `command` between steps.
    command_limits: dict[str, tuple[float, float]] = {}
    command: Tensor

    @property
    def base(self) -> int:
        """The first body of the robot's kinematic tree, by its index."""
        return base_of(self.physics.model, self.base_body)

    @abstractmethod
    def layout(self) -> list[Part]:
        """Name the parts of an observation, in order."""

    def targets(self) -> list[str] | None:
        """Return the joint of each action; None: actions are the model's actuators, in order."""
        return None

    def scales(self) -> tuple[list[float], list[float]] | None:
        """Return scale and offset of each action if its joint is to go to offset + scale * action.

        None: the mapping has another form, or actions are the model's actuators.
        """
        return None

    def deployment(self) -> Deployment | None:
        """Return how to drive the robot outside; None unless actions are positions of joints."""
        return None


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
    data = mujoco.MjData(model)
    stages = mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission
    for compute in stages:
        compute(model, data)
    counts = np.zeros(model.ntree, int)  # of the actuators that act on each tree
    for start, number in zip(data.moment_rowadr, data.moment_rownnz, strict=True):
        dofs = data.moment_colind[start : start + number]
        counts[np.unique(model.dof_treeid[dofs])] += 1
    freedoms = np.bincount(model.dof_treeid, minlength=model.ntree)
    robot = max(range(model.ntree), key=lambda tree: (counts[tree], freedoms[tree], -tree))
    return int(np.flatnonzero(trees == robot)[0])


def horizontal(model: mujoco.MjModel, base: int) -> list[int]:
    """Return the degrees of freedom that move the base along the floor."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dofs = []
    for joint in np.flatnonzero(model.jnt_bodyid == base):
        kind, dof = model.jnt_type[joint], int(model.jnt_dofadr[joint])
        if kind == mjtJoint.mjJNT_FREE:
            return [dof, dof + 1]
        if kind == mjtJoint.mjJNT_SLIDE and abs(data.xaxis[joint, 2]) < LEVEL:
            dofs.append(dof)
    return dofs
