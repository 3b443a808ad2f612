"""A MuJoCo robot for viewers, films and exports, and the names of what it observes."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import mujoco
from mujoco import mjtJoint
from torch import Tensor

from .interface import Worlds
from .trees import base_of


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


def velocities(model: mujoco.MjModel, limit: float = math.inf) -> list[Part]:
    """Name the parts of `qvel`, clipped to [-limit, limit] if there is a limit."""
    clipped = "" if limit == math.inf else f", clipped to [{-limit:g}, {limit:g}]"
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
    motions: Sequence[bytes] = ()  # npz files of what it follows, one frame per control step


class Robot(Worlds):
    """N worlds of a robot whose MuJoCo model is known."""

    # Has a `model`, and the state of N worlds of it, such as `qpos` (N, nq), `qvel`, `ctrl` and
    # `act`. Write to the state to move a robot.
    physics: Any
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

    def ghost(self) -> Tensor | None:
        """Return the pose (nq,) that the first robot should have; None: it follows no motion."""
        return None

    def deployment(self) -> Deployment | None:
        """Return how to drive the robot outside; None unless actions are positions of joints."""
        return None
