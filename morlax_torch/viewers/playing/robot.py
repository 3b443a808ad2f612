"""One robot in C MuJoCo that is driven as deploy.yaml says."""

from collections import deque
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...envs.worlds.trees import base_of
from .deployment import Export
from .disturbances import Disturbances, Disturber
from .settings import Term

Array = NDArray[np.float64]
FALLEN = np.cos(np.radians(70))  # of the tilt of the base, as in mjlab's termination
RISE = 0.02  # m of the base above its default pose at the start
BROKEN = (  # of which MuJoCo warns before it resets the state
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


class Step(NamedTuple):
    """What a control step came to."""

    fallen: bool
    velocity: Array  # (3,): m/s ahead, m/s to the left, rad/s to the left, of the base
    power: float  # W, positive mechanical power of all joints


class Robot:
    """A robot whose base moves freely, with the gains, targets and observation of deploy.yaml.

    Without disturbances, its friction is the model's, and a step equals one of mjlab.

    Raises:
        MorlaxError: an observation is not known, or model and settings do not fit together.
    """

    def __init__(
        self,
        deployment: Export,
        disturbances: Disturbances | None = None,
        seed: int | np.random.SeedSequence = 0,
    ):
        settings = deployment.settings
        own, action = settings.morlax_torch, settings.action
        self.model, self.dt = copy(deployment.model), settings.step_dt
        self.data = mujoco.MjData(self.model)
        rng = np.random.default_rng(seed)
        self.base = base_of(self.model)
        self._disturber = Disturber(disturbances, self.model, rng)
        self._substeps = round(self.dt / self.model.opt.timestep)
        self._terms = list(zip(settings.observations.items(), own.observation_noise, strict=True))
        joints = [self._joint(name) for name in own.joints]
        free = self.model.body_jntadr[self.base]
        self._height, self._speed = self.model.jnt_qposadr[free] + 2, self.model.jnt_dofadr[free]
        self._qpos = np.array([self.model.jnt_qposadr[joint] for joint in joints])
        self._qvel = np.array([self.model.jnt_dofadr[joint] for joint in joints])
        self._rest = np.array(settings.default_joint_pos), np.array(own.default_joint_vel)
        driven = settings.driven
        self._motors = np.array([self._motor(joints[index]) for index in driven])
        self._scale, self._offset = np.array(action.scale), np.array(action.offset)
        self._clip = np.array(action.clip or [(-np.inf, np.inf)]).T  # (2, A) or (2, 1)
        self._start = self._rest[0][driven]
        gains = settings.stiffness, settings.damping
        self._set_gains(*(np.array(values, float)[driven] for values in gains))
        self.reset()
        for (name, term), _ in self._terms:
            self._check(name, term)

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
        self._disturber.restart()
        mujoco.mj_forward(self.model, self.data)

    def observe(self, command: Array) -> Array:
        """Return the observation (O,) under a command (3,). Call it once per control step."""
        self.command = command
        parts = []
        for (name, term), noise in self._terms:
            value = self._disturber.noisy(READERS[name](self, term.params), noise)
            if term.clip:
                value = value.clip(*term.clip)
            parts.append(value * np.array(term.scale))
        if not self._histories:
            lengths = [term.history_length for (_, term), _ in self._terms]
            self._histories = [
                deque([part] * length, length) for part, length in zip(parts, lengths, strict=True)
            ]
        for history, part in zip(self._histories, parts, strict=True):
            history.append(part)
        return np.concatenate([part for history in self._histories for part in history])

    def step(self, action: Array) -> Step:
        """Move on by a control step with an action (A,) of the policy."""
        self.action = action
        target = (self._offset + self._scale * action).clip(*self._clip)
        self._pending.append((self._count + self._disturber.delay, target))
        power = 0.0
        for _ in range(self._substeps):
            while self._pending and self._pending[0][0] <= self._count:
                self.data.ctrl[self._motors] = self._pending.popleft()[1]
            mujoco.mj_step(self.model, self.data)
            self._count += 1
            made = self.data.qfrc_actuator[self._qvel] * self.data.qvel[self._qvel]
            power += float(made.clip(min=0).sum()) / self._substeps
        self._disturber.push(self.data, self._speed)
        mujoco.mj_forward(self.model, self.data)
        return Step(self._has_fallen(), self.velocity(), power)

    def velocity(self) -> Array:
        """Return the base's velocity (3,) in the body: m/s, m/s and rad/s of the yaw."""
        return np.array([*(self._twist()[:3] @ self._turn())[:2], self._twist()[5]])

    def weight(self) -> float:
        """Return the robot's weight in N."""
        mass = self.model.body_subtreemass[self.base]
        return float(mass * np.linalg.norm(self.model.opt.gravity))

    def _has_fallen(self) -> bool:
        broken = any(self.data.warning[kind].number for kind in BROKEN)
        return broken or not self._turn()[2, 2] > FALLEN

    def _turn(self) -> Array:
        """Return the rotation (3, 3) of the base."""
        return self.data.xmat[self.base].reshape(3, 3)

    def _twist(self) -> Array:
        """Return the velocity (6,) of the base: in the world, and of its turning in the body."""
        return self.data.qvel[self._speed : self._speed + 6]

    def _check(self, name: str, term: Term) -> None:
        """Raise MorlaxError unless the term can be observed and has the size of its scale."""
        sensor = term.params.get("sensor_name")
        if sensor and mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, sensor) < 0:
            raise MorlaxError(f"the model has no sensor {sensor} for the observation {name}.")
        if name not in READERS:
            raise MorlaxError(
                f"play does not know the observation {name}: it knows {', '.join(READERS)}."
            )
        size = len(READERS[name](self, term.params))
        if size != len(term.scale):
            raise MorlaxError(
                f"the observation {name} has {size} numbers, but its scale {len(term.scale)}."
            )

    def _sensor(self, name: str) -> Array:
        return self.data.sensor(name).data.copy()

    def _joint(self, name: str) -> int:
        joint = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)
        free = self.model.body_jntadr[self.base]
        if joint < 0 or self.model.jnt_type[free] != mujoco.mjtJoint.mjJNT_FREE:
            raise MorlaxError(f"the model has no joint {name} on a base that moves freely.")
        return joint

    def _motor(self, joint: int) -> int:
        found = np.flatnonzero(self.model.actuator_trnid[:, 0] == joint)
        if len(found) != 1:
            name = self.model.joint(joint).name
            raise MorlaxError(f"the model has {len(found)} actuators for {name} instead of one.")
        return int(found[0])

    def _set_gains(self, stiffness: Array, damping: Array) -> None:
        """Let the model's motors have the gains of deploy.yaml, which may have been edited."""
        self.model.actuator_gainprm[self._motors, 0] = stiffness
        self.model.actuator_biasprm[self._motors, 1] = -stiffness
        self.model.actuator_biasprm[self._motors, 2] = -damping


def _gravity(robot: Robot, params: dict) -> Array:
    up = robot._sensor(params["sensor_name"]) if "sensor_name" in params else robot._turn()[2]
    return -up


def _linear(robot: Robot, params: dict) -> Array:
    if "sensor_name" in params:
        return robot._sensor(params["sensor_name"])
    return robot._twist()[:3] @ robot._turn()


def _angular(robot: Robot, params: dict) -> Array:
    if "sensor_name" in params:
        return robot._sensor(params["sensor_name"])
    return robot._twist()[3:].copy()


READERS = {  # values of each term of unitree_rl_lab before noise, clip and scale
    "base_lin_vel": _linear,
    "base_ang_vel": _angular,
    "projected_gravity": _gravity,
    "velocity_commands": lambda robot, params: robot.command,
    "joint_pos_rel": lambda robot, params: robot.data.qpos[robot._qpos] - robot._rest[0],
    "joint_vel_rel": lambda robot, params: robot.data.qvel[robot._qvel] - robot._rest[1],
    "last_action": lambda robot, params: robot.action,
}
