"""Open an export, and drive its robot in C MuJoCo as deploy.yaml says, with disturbances."""

import io
import math
import zipfile
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import mjtWarning
from numpy.typing import NDArray
from pydantic import AliasPath, BaseModel, Field, model_validator

from ...configuration.files import read_yaml
from ...configuration.schedules import Schedule
from ...envs.errors import MorlaxError, unknown, validated
from ...envs.worlds.trees import base_of
from ...exports.deployment import SETTINGS
from ...host.files import attempting, read

Values = list[float]
Range = tuple[float, float]
Array = NDArray[np.float64]
JOINT = mujoco.mjtObj.mjOBJ_JOINT
FALLEN = np.cos(np.radians(70))  # of the tilt of the base, as in mjlab's termination
RISE = 0.02  # m of the base above its default pose at the start
PAUSES = 1.0, 3.0  # s between two pushes, as in mjlab's training
# of which MuJoCo warns before it resets the state
BROKEN = mjtWarning.mjWARN_BADQPOS, mjtWarning.mjWARN_BADQVEL, mjtWarning.mjWARN_BADQACC


def _in(*path: str, **constraints: Any) -> Any:
    """Return a field that lies deeper in deploy.yaml."""
    return Field(validation_alias=AliasPath(*path), **constraints)


class Term(BaseModel):
    """A term of the observation."""

    params: dict[str, Any]
    clip: Range | None
    scale: Values
    history_length: int = Field(ge=1)
    joint_ids: list[int] | None = _in("params", "asset_cfg", "joint_ids", default=None)


AXES = "lin_vel_x", "lin_vel_y", "ang_vel_z"
RANGES = "commands", "base_velocity", "ranges"
ACTION = "actions", "JointPositionAction"
OURS = "morlax_torch"  # the entries that unitree_rl_lab does not have


class Settings(BaseModel):
    """The entries of deploy.yaml that are used here; docs/export.md explains all of them."""

    step_dt: float = Field(gt=0)
    stiffness: list[float | None]
    damping: list[float | None]
    default_joint_pos: Values
    observations: dict[str, Term]
    ranges: dict[str, Range | None] = _in(*RANGES, default={})
    clip: list[Range] | None = _in(*ACTION, "clip")
    scale: Values = _in(*ACTION, "scale")
    offset: Values = _in(*ACTION, "offset")
    joint_ids: list[int] | None = _in(*ACTION, "joint_ids")
    policy: str = _in(OURS, "policy")
    model: str = _in(OURS, "model")
    motion: str | None = _in(OURS, "motion", default=None)
    anchor_body: str = _in(OURS, "anchor_body", default="")
    key_bodies: list[str] = _in(OURS, "key_bodies", default=[])
    objectives: list[str] = _in(OURS, "objectives")
    slew: float | None = _in(OURS, "slew", gt=0)
    joints: list[str] = _in(OURS, "joints")
    default_joint_vel: Values = _in(OURS, "default_joint_vel")
    observation_noise: Values = _in(OURS, "observation_noise")

    @property
    def driven(self) -> list[int]:
        """The joint of each action."""
        return list(range(len(self.joints))) if self.joint_ids is None else self.joint_ids

    @property
    def limits(self) -> list[Range]:
        """The range of each number of the command: m/s, m/s, rad/s."""
        return [self.ranges.get(axis) or (0.0, 0.0) for axis in AXES]

    @model_validator(mode="after")
    def _check(self) -> "Settings":
        if self.motion is None and not all(map(self.ranges.get, AXES)):
            raise ValueError(f"{'.'.join(RANGES)} needs {', '.join(AXES)}.")
        if self.motion is not None and self.anchor_body not in self.key_bodies:
            raise ValueError(f"the anchor_body {self.anchor_body} is not among key_bodies.")
        driven, joints = self.driven, range(len(self.joints))
        counts = dict.fromkeys(("scale", "offset", "clip"), len(driven))
        names = ("stiffness", "damping", "default_joint_pos", "default_joint_vel")
        counts |= dict.fromkeys(names, len(joints)) | {"observation_noise": len(self.observations)}
        for name, count in counts.items():
            values = getattr(self, name)
            if values is not None and len(values) != count:
                raise ValueError(f"{name} has {len(values)} entries instead of {count}.")
        observed = [index for term in self.observations.values() for index in term.joint_ids or ()]
        if not {*driven, *observed} <= set(joints):
            raise ValueError("joint_ids names a joint that does not exist.")
        passive = [self.joints[i] for i in driven if None in (self.stiffness[i], self.damping[i])]
        if passive:
            raise ValueError(
                f"{', '.join(passive)} have no gains (null): write their stiffness and damping."
            )
        return self


class Motion(NamedTuple):
    """T frames of J joints and K key bodies, the first of which is the base."""

    joint_pos: Array  # (T, J): rad
    joint_vel: Array  # (T, J): rad/s
    body_pos_w: Array  # (T, K, 3): m, in the world
    body_quat_w: Array  # (T, K, 4): quaternions, w first


@dataclass
class Disturbances:
    """Strengths of disturbances; delay and friction are drawn anew for each episode."""

    delay: tuple[float, float] = (0.0, 20.0)  # ms from an observation to its action
    noise: float = 1.0  # factor on the observation noise of the training
    push: float = 0.5  # largest change of the base's horizontal velocity, in m/s along each axis
    friction: tuple[float, float] = (0.3, 1.2)  # sliding, of all contacts that have friction

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            low, high = np.broadcast_to(value, 2)
            if not 0 <= low <= high < math.inf:
                raise MorlaxError(f"--{name} must not be negative, nor LOW above HIGH.")


class Export(NamedTuple):
    """An export that can be played."""

    settings: Settings
    model: mujoco.MjModel
    policy: Path
    motion: Motion | None = None
    tradeoff: Schedule | None = None  # that the user gives; None: random, or steered
    disturbances: Disturbances | None = None  # under which it is played

    @property
    def duration(self) -> float | None:
        """The seconds of the motion, if there is one."""
        return self.motion and len(self.motion.joint_pos) * self.settings.step_dt


def open_export(path: Path, tradeoff: str | None = None) -> Export:
    """Open an export by its folder or the file of its policy, with a trade-off or its FILE.yaml."""
    folder = path if path.is_dir() else path.parent
    file = folder / SETTINGS
    if not path.exists() or not file.exists():
        raise MorlaxError(
            f"there is no export {path} with {SETTINGS}: morlax export writes one for tasks "
            "of mjlab whose actions are positions of joints."
        )
    values = read_yaml(file, "settings", "step_dt: 0.02")
    settings = validated(Settings, values, f"{file}: ")
    archive = folder / settings.model
    content = io.BytesIO(read(archive, "model"))
    with attempting(f"load the model {archive}", ValueError, zipfile.BadZipFile):
        model = mujoco.MjSpec.from_zip(content).compile()
    policy = folder / settings.policy if path == folder else path
    schedule = None if tradeoff is None else _schedule(tradeoff, settings)
    return Export(settings, model, policy, _motion(folder, settings), schedule)


def _schedule(text: str, settings: Settings) -> Schedule:
    """Read a trade-off over the time of a motion, or one that never changes."""
    if not text.endswith(".yaml"):
        from ...configuration.tradeoffs import parse_tradeoff  # imports torch

        weights = parse_tradeoff(text, settings.objectives)
        return Schedule(np.zeros(1), np.array([weights]) / sum(weights))
    if settings.motion is None:
        raise MorlaxError(
            f"{text} is a trade-off over the time of a motion, and this export follows none: give "
            "--tradeoff one weight per objective."
        )
    return Schedule.load(text, settings.objectives)


def _motion(folder: Path, settings: Settings) -> Motion | None:
    if settings.motion is None:
        return None
    path, names = folder / settings.motion, Motion._fields
    content, (J, K) = read(path, "motion"), (len(settings.joints), len(settings.key_bodies))
    damage = KeyError, ValueError, EOFError, zipfile.BadZipFile
    with attempting(f"load the motion {path}", *damage), np.load(io.BytesIO(content)) as file:
        motion = Motion(*(file[name].astype(float) for name in names))
    for name, array, shape in zip(names, motion, ((J,), (J,), (K, 3), (K, 4)), strict=True):
        if array.shape != (expected := (len(motion.joint_pos), *shape)):
            raise MorlaxError(f"{name} of {path} has the shape {array.shape}, not {expected}.")
    return motion


class Step(NamedTuple):
    """The outcome of a control step."""

    fallen: bool
    velocity: Array  # (3,): m/s ahead, m/s to the left, rad/s to the left, of the base
    power: float  # W, positive mechanical power of all joints
    error: float  # m/s, between commanded and actual horizontal velocity, or mm from a motion
    over: bool = False  # the motion has ended


class Robot:
    """A robot whose base moves freely, with the gains, targets and observation of deploy.yaml.

    Without disturbances, its friction is the model's, and a step equals one of mjlab.
    """

    seconds = 0.0  # since a motion began

    def __init__(self, deployment: Export, seed: int | np.random.SeedSequence = 0):
        settings, disturbances = deployment.settings, deployment.disturbances
        self._driven = driven = settings.driven
        self.model = model = copy(deployment.model)
        mujoco.set_mju_user_warning(lambda message: None)  # see `broken`; no MUJOCO_LOG.TXT
        self.data, self.dt = mujoco.MjData(model), settings.step_dt
        self.base = base_of(model)
        self._disturbances = disturbances or Disturbances((0.0, 0.0), 0.0, 0.0)
        self._changes_friction = disturbances is not None
        collides = (model.geom_contype | model.geom_conaffinity) > 0
        self._sliding = collides & (model.geom_condim > 1)
        self._rng = np.random.default_rng(seed)
        timestep = model.opt.timestep
        self._substeps = round(self.dt / timestep)
        # the numbers of an export are rounded
        if not math.isclose(self._substeps * timestep, self.dt, rel_tol=1e-5):
            raise MorlaxError(
                f"step_dt is {self.dt:g}: use a multiple of {timestep:g}, the model's time step."
            )
        self._terms = list(settings.observations.items())
        self._noise = np.array(settings.observation_noise) * self._disturbances.noise
        free = model.body_jntadr[self.base]
        self._joints = joints = [mujoco.mj_name2id(model, JOINT, name) for name in settings.joints]
        for name, joint in zip(settings.joints, joints, strict=True):
            if joint < 0 or model.jnt_type[free] != mujoco.mjtJoint.mjJNT_FREE:
                raise MorlaxError(f"the model has no joint {name} on a base that moves freely.")
        self._height, self._speed = model.jnt_qposadr[free] + 2, model.jnt_dofadr[free]
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._rest = np.array(settings.default_joint_pos), np.array(settings.default_joint_vel)
        motors = [np.flatnonzero(model.actuator_trnid[:, 0] == joints[index]) for index in driven]
        if any(len(indices) != 1 for indices in motors):
            raise MorlaxError("each joint with an action needs one actuator of the model.")
        self._motors = np.concatenate(motors)
        self._scale, self._offset = np.array(settings.scale), np.array(settings.offset)
        self._clip = np.array(settings.clip or [(-np.inf, np.inf)]).T  # (2, A) or (2, 1)
        # the gains of deploy.yaml, which may have been edited
        stiffness = np.array(settings.stiffness, float)[driven]
        damping = np.array(settings.damping, float)[driven]
        model.actuator_gainprm[self._motors, 0] = stiffness
        model.actuator_biasprm[self._motors, 1] = -stiffness
        model.actuator_biasprm[self._motors, 2] = -damping
        # a motor of the model whose control is its torque becomes a servo with these gains
        torques = self._motors[model.actuator_biastype[self._motors] == mujoco.mjtBias.mjBIAS_NONE]
        model.actuator_biastype[torques] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_ctrllimited[torques] = 0
        self.reset()
        for name, term in self._terms:
            size = len(self._values(name, term))
            if size != len(term.scale):
                raise MorlaxError(f"{name} has {size} numbers, but its scale {len(term.scale)}.")

    def reset(self) -> None:
        """Start an episode just above the default pose."""
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)  # if there is one
        self.data.qpos[self._height] += RISE
        self.data.qpos[self._qpos], self.data.qvel[self._qvel] = self._rest
        self.data.ctrl[self._motors] = self._rest[0][self._driven]
        self.data.time = 0.0
        self.action = np.zeros(len(self._motors))
        self.command = np.zeros(3)
        self._pending: deque[tuple[int, Array]] = deque()
        self._histories = [deque[Array](maxlen=term.history_length) for _, term in self._terms]
        self._count = 0  # physics steps
        delay = self._rng.uniform(*self._disturbances.delay)
        self._delay = round(delay / 1000 / self.model.opt.timestep)  # physics steps
        if self._changes_friction:
            friction = self._rng.uniform(*self._disturbances.friction)
            self.model.geom_friction[self._sliding, 0] = friction
        self._next_push = self._rng.uniform(*PAUSES)
        mujoco.mj_forward(self.model, self.data)

    def observe(self, command: Array) -> Array:
        """Return the observation (O,) under a command (3,). Call it once per control step."""
        self.command = command
        columns = zip(self._terms, self._noise, self._histories, strict=True)
        for (name, term), noise, history in columns:
            value = self._values(name, term)
            if noise:
                value = value + self._rng.uniform(-noise, noise, value.shape)
            if term.clip:
                value = value.clip(*term.clip)
            # the first observation fills the history
            repeats = 1 if history else term.history_length
            history.extend([value * np.array(term.scale)] * repeats)
        return np.concatenate([part for history in self._histories for part in history])

    def step(self, action: Array) -> Step:
        """Move on by a control step with an action (A,) of the policy."""
        self.action = action
        target = (self._offset + self._scale * action).clip(*self._clip)
        self._pending.append((self._count + self._delay, target))
        power = 0.0
        for _ in range(self._substeps):
            while self._pending and self._pending[0][0] <= self._count:
                self.data.ctrl[self._motors] = self._pending.popleft()[1]
            mujoco.mj_step(self.model, self.data)
            self._count += 1
            powers = self.data.qfrc_actuator[self._qvel] * self.data.qvel[self._qvel]
            power += float(powers.clip(min=0).sum()) / self._substeps
        if self.data.time >= self._next_push:
            self._next_push = self.data.time + self._rng.uniform(*PAUSES)
            most = self._disturbances.push
            self._twist()[:2] += self._rng.uniform(-most, most, 2)
        mujoco.mj_forward(self.model, self.data)
        fallen = self.broken() or not self._turn()[2, 2] > FALLEN
        velocity = self.velocity()
        error = float(np.linalg.norm(self.command[:2] - velocity[:2]))
        return Step(fallen, velocity, power, error)

    def broken(self) -> bool:
        """Return whether MuJoCo has reset a state that is not finite or too large."""
        return any(self.data.warning[kind].number for kind in BROKEN)

    def velocity(self) -> Array:
        """Return the velocity (3,) that a `Step` has."""
        return np.array([*(self._twist()[:3] @ self._turn())[:2], self._twist()[5]])

    def ghost(self) -> mujoco.MjData | None:
        """Return the state that the robot should have; None: it follows no motion."""
        return None

    def weight(self) -> float:
        """Return the robot's weight in N."""
        mass = self.model.body_subtreemass[self.base]
        return float(mass * np.linalg.norm(self.model.opt.gravity))

    def _turn(self) -> Array:
        """Return the rotation (3, 3) of the base."""
        return self.data.xmat[self.base].reshape(3, 3)

    def _twist(self) -> Array:
        """Return the velocity (6,) of the base: in the world, and of its turning in the body."""
        return self.data.qvel[self._speed : self._speed + 6]

    def _values(self, name: str, term: Term) -> Array:
        """Return the values of a term before noise, clip and scale."""
        values = self._read(name, term.params)
        return values if term.joint_ids is None else values[term.joint_ids]

    def _read(self, name: str, params: dict) -> Array:
        """Return the values of a term, of all joints."""
        if name not in OBSERVATIONS:
            raise unknown("observation", name, OBSERVATIONS)
        if "sensor_name" not in params:
            return OBSERVATIONS[name](self)
        try:
            values = self.data.sensor(params["sensor_name"]).data.copy()
        except KeyError as error:
            raise MorlaxError(f"observation {name} needs a sensor: {error.args[0]}.") from None
        return -values if name == "projected_gravity" else values


OBSERVATIONS: dict[str, Callable[[Robot], Array]] = {  # the terms of unitree_rl_lab
    "base_lin_vel": lambda robot: robot._twist()[:3] @ robot._turn(),
    "base_ang_vel": lambda robot: robot._twist()[3:].copy(),
    "projected_gravity": lambda robot: -robot._turn()[2],
    "velocity_commands": lambda robot: robot.command,
    "joint_pos_rel": lambda robot: robot.data.qpos[robot._qpos] - robot._rest[0],
    "joint_vel_rel": lambda robot: robot.data.qvel[robot._qvel] - robot._rest[1],
    "last_action": lambda robot: robot.action,
}
