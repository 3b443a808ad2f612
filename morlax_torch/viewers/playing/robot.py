"""One robot in C MuJoCo that is driven as deploy.yaml says, with disturbances."""

import math
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.worlds.trees import base_of
from .deployment import Export

Array = NDArray[np.float64]
FALLEN = np.cos(np.radians(70))  # of the tilt of the base, as in mjlab's termination
RISE = 0.02  # m of the base above its default pose at the start
PAUSES = 1.0, 3.0  # s between two pushes, as in mjlab's training
BROKEN = (  # of which MuJoCo warns before it resets the state
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


@dataclass
class Disturbances:
    """Strengths of disturbances; delay and friction are drawn anew for each episode."""

    delay: tuple[float, float] = (0.0, 20.0)
    """Milliseconds from an observation to the action that it causes."""
    noise: float = 1.0
    """Factor on the observation noise of the training."""
    push: float = 0.5
    """Largest change of the base's horizontal velocity, in m/s along each axis."""
    friction: tuple[float, float] = (0.3, 1.2)
    """Sliding friction of all contacts that have friction."""

    def __post_init__(self) -> None:
        for name, (low, high) in (("delay", self.delay), ("friction", self.friction)):
            if not 0 <= low <= high < math.inf:
                raise MorlaxError(
                    f"--{name} needs two numbers, the lower one first and not negative, not "
                    f"{low:g} {high:g}."
                )
        for name in ("noise", "push"):
            if not 0 <= getattr(self, name) < math.inf:
                raise MorlaxError(f"--{name} must not be negative, nor {getattr(self, name):g}.")


class Step(NamedTuple):
    """The outcome of a control step."""

    fallen: bool
    velocity: Array  # (3,): m/s ahead, m/s to the left, rad/s to the left, of the base
    power: float  # W, positive mechanical power of all joints


class Robot:
    """A robot whose base moves freely, with the gains, targets and observation of deploy.yaml.

    Without disturbances, its friction is the model's, and a step equals one of mjlab.
    """

    def __init__(
        self,
        deployment: Export,
        disturbances: Disturbances | None = None,
        seed: int | np.random.SeedSequence = 0,
    ):
        settings = deployment.settings
        driven = settings.driven
        self.model = model = copy(deployment.model)
        self.data, self.dt = mujoco.MjData(model), settings.step_dt
        self.base = base_of(model)
        self._disturbances = disturbances or Disturbances((0.0, 0.0), 0.0, 0.0)
        self._changes_friction = disturbances is not None
        collides = (model.geom_contype | model.geom_conaffinity) > 0
        self._sliding = collides & (model.geom_condim > 1)
        self._rng = np.random.default_rng(seed)
        self._substeps = round(self.dt / model.opt.timestep)
        self._terms = list(settings.observations.items())
        self._noise = np.array(settings.observation_noise) * self._disturbances.noise
        joints = [self._joint(name) for name in settings.joints]
        free = model.body_jntadr[self.base]
        self._height, self._speed = model.jnt_qposadr[free] + 2, model.jnt_dofadr[free]
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._rest = np.array(settings.default_joint_pos), np.array(settings.default_joint_vel)
        self._motors = np.array([self._motor(joints[index]) for index in driven])
        self._scale, self._offset = np.array(settings.scale), np.array(settings.offset)
        self._clip = np.array(settings.clip or [(-np.inf, np.inf)]).T  # (2, A) or (2, 1)
        # the gains of deploy.yaml, which may have been edited
        gains = settings.stiffness, settings.damping
        stiffness, damping = (np.array(values, float)[driven] for values in gains)
        model.actuator_gainprm[self._motors, 0] = stiffness
        model.actuator_biasprm[self._motors, 1] = -stiffness
        model.actuator_biasprm[self._motors, 2] = -damping
        self._start = self._rest[0][driven]
        self.reset()
        for name, term in self._terms:
            if name not in OBSERVATIONS:
                raise MorlaxError(
                    f"play does not know the observation {name}: it knows "
                    f"{', '.join(OBSERVATIONS)}."
                )
            size = len(self._read(name, term.params))
            if size != len(term.scale):
                raise MorlaxError(
                    f"the observation {name} has {size} numbers, but its scale {len(term.scale)}."
                )

    def reset(self) -> None:
        """Start an episode just above the default pose."""
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        else:
            mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._height] += RISE
        self.data.qpos[self._qpos], self.data.qvel[self._qvel] = self._rest
        self.data.ctrl[self._motors] = self._start
        self.data.time = 0.0
        self.action = np.zeros(len(self._motors))
        self.command = np.zeros(3)
        self._pending: deque[tuple[int, Array]] = deque()
        self._histories: list[deque[Array]] = []
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
        parts = []
        for (name, term), noise in zip(self._terms, self._noise, strict=True):
            value = self._read(name, term.params)
            if noise:
                value = value + self._rng.uniform(-noise, noise, value.shape)
            if term.clip:
                value = value.clip(*term.clip)
            parts.append(value * np.array(term.scale))
        if not self._histories:
            pairs = zip(parts, self._terms, strict=True)
            lengths = [(part, term.history_length) for part, (_, term) in pairs]
            self._histories = [deque([part] * length, length) for part, length in lengths]
        for history, part in zip(self._histories, parts, strict=True):
            history.append(part)
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
            made = self.data.qfrc_actuator[self._qvel] * self.data.qvel[self._qvel]
            power += float(made.clip(min=0).sum()) / self._substeps
        if self.data.time >= self._next_push:
            self._next_push = self.data.time + self._rng.uniform(*PAUSES)
            most = self._disturbances.push
            self._twist()[:2] += self._rng.uniform(-most, most, 2)
        mujoco.mj_forward(self.model, self.data)
        broken = any(self.data.warning[kind].number for kind in BROKEN)
        return Step(broken or not self._turn()[2, 2] > FALLEN, self.velocity(), power)

    def velocity(self) -> Array:
        """Return the base's velocity (3,) in the body: m/s, m/s and rad/s of the yaw."""
        return np.array([*(self._twist()[:3] @ self._turn())[:2], self._twist()[5]])

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

    def _read(self, name: str, params: dict) -> Array:
        """Return the values of a term before noise, clip and scale."""
        if "sensor_name" not in params:
            return OBSERVATIONS[name](self)
        sensor = params["sensor_name"]
        if mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, sensor) < 0:
            raise MorlaxError(f"the model has no sensor {sensor} for the observation {name}.")
        values = self.data.sensor(sensor).data.copy()
        return -values if name == "projected_gravity" else values

    def _joint(self, name: str) -> int:
        joint = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)
        free = self.model.body_jntadr[self.base]
        if joint < 0 or self.model.jnt_type[free] != mujoco.mjtJoint.mjJNT_FREE:
            raise MorlaxError(f"the model has no joint {name} on a base that moves freely.")
        return joint

    def _motor(self, joint: int) -> int:
        motors = np.flatnonzero(self.model.actuator_trnid[:, 0] == joint)
        if len(motors) != 1:
            name = self.model.joint(joint).name
            raise MorlaxError(f"the model has {len(motors)} actuators for {name} instead of one.")
        return int(motors[0])


OBSERVATIONS: dict[str, Callable[[Robot], Array]] = {  # the terms of unitree_rl_lab
    "base_lin_vel": lambda robot: robot._twist()[:3] @ robot._turn(),
    "base_ang_vel": lambda robot: robot._twist()[3:].copy(),
    "projected_gravity": lambda robot: -robot._turn()[2],
    "velocity_commands": lambda robot: robot.command,
    "joint_pos_rel": lambda robot: robot.data.qpos[robot._qpos] - robot._rest[0],
    "joint_vel_rel": lambda robot: robot.data.qvel[robot._qvel] - robot._rest[1],
    "last_action": lambda robot: robot.action,
}
