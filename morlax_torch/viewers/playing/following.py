"""A robot in C MuJoCo that follows the motion of its export."""

import math

import mujoco
import numpy as np

from ...envs import MorlaxError
from .motion import Motion
from .robot import Array, Disturbances, Export, Robot, Step

HOLD = 2.0  # s for which the robot stands in the last frame
LOW, TILTED = 0.25, 0.8  # m, and of the vertical axis: a fall, as in mjlab's terminations


class Follower(Robot):
    """A robot that follows a motion, from a stand in its first frame to a stand in its last one.

    `frame` is the one that the robot is to reach by the end of the next control step.
    """

    def __init__(
        self,
        deployment: Export,
        disturbances: Disturbances | None = None,
        seed: int | np.random.SeedSequence = 0,
    ):
        settings, model = deployment.settings, deployment.model
        assert deployment.motion is not None
        self.motion: Motion = deployment.motion
        self._driven, self._anchor = settings.driven, settings.anchor
        kind = mujoco.mjtObj.mjOBJ_BODY
        self._bodies = [mujoco.mj_name2id(model, kind, name) for name in settings.key_bodies]
        if -1 in self._bodies:
            missing = settings.key_bodies[self._bodies.index(-1)]
            raise MorlaxError(f"the model has no body {missing}, which key_bodies names.")
        super().__init__(deployment, disturbances, seed)

    @property
    def over(self) -> bool:
        return self.frame >= len(self.motion.joints) + round(HOLD / self.dt)

    def reset(self) -> None:
        """Stand in the first frame."""
        super().reset()
        self.frame = 1
        self.data.ctrl[self._motors] = self.motion.joints[0][self._driven]
        self._place(self.data, 0)

    def step(self, action: Array) -> Step:
        """Move on by a control step; the error (mm) is that of mjlab, relative to the root."""
        aims = self._aims()
        step = super().step(action)
        error = 1000 * np.linalg.norm(self.data.xpos[self._bodies] - aims, axis=1).mean()
        place, turn = self._pose()
        aim, aimed = self._aim()
        fallen = not (abs(place - aim)[2] < LOW and abs(turn - aimed)[2, 2] < TILTED)
        self.frame += 1
        return step._replace(fallen=fallen or self.broken(), error=float(error))

    def ghost(self) -> mujoco.MjData:
        ghost = mujoco.MjData(self.model)
        self._place(ghost, min(self.frame, len(self.motion.joints)) - 1)
        return ghost

    def _place(self, data: mujoco.MjData, frame: int) -> None:
        motion, base = self.motion, self._height - 2
        data.qpos[base : base + 7] = [*motion.places[frame, 0], *motion.turns[frame, 0]]
        data.qpos[self._qpos], data.qvel[:] = motion.joints[frame], 0.0
        mujoco.mj_forward(self.model, data)

    @property
    def _at(self) -> int:
        return min(self.frame, len(self.motion.joints) - 1)

    def _pose(self) -> tuple[Array, Array]:
        """Return position (3,) and rotation (3, 3) of the anchor body."""
        body = self._bodies[self._anchor]
        return self.data.xpos[body].copy(), self.data.xmat[body].reshape(3, 3).copy()

    def _aim(self) -> tuple[Array, Array]:
        """Return position (3,) and rotation (3, 3) of the anchor body in the frame."""
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, self.motion.turns[self._at, self._anchor])
        return self.motion.places[self._at, self._anchor], matrix.reshape(3, 3)

    def _aims(self) -> Array:
        """Return positions (K, 3) of key bodies in the frame, moved to the robot.

        The anchor body has the robot's place on the ground and its heading.
        """
        place, turn = self._pose()
        aim, aimed = self._aim()
        (x, *_), (y, *_), _ = turn @ aimed.T
        cos, sin = np.array([x, y]) / math.hypot(x, y)
        heading = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        around = (self.motion.places[self._at] - aim) @ heading.T
        return np.array([*place[:2], aim[2]]) + around

    def _read(self, name: str, params: dict) -> Array:
        place, turn = self._pose()
        aim, aimed = self._aim()
        match name:
            case "motion_command":
                moves = self.frame < len(self.motion.joints)
                speeds = moves * self.motion.speeds[self._at]
                return np.concatenate([self.motion.joints[self._at], speeds])
            case "motion_anchor_pos_b":
                return (aim - place) @ turn
            case "motion_anchor_ori_b":
                return (turn.T @ aimed)[:, :2].ravel()
        return super()._read(name, params)


def robot_for(
    deployment: Export,
    disturbances: Disturbances | None = None,
    seed: int | np.random.SeedSequence = 0,
) -> Robot:
    """Return the robot of an export, which follows a motion if there is one."""
    kind = Robot if deployment.motion is None else Follower
    return kind(deployment, disturbances, seed)


def duration(deployment: Export, default: float) -> float:
    """Return the seconds until the end of the last stand; the default without a motion."""
    if deployment.motion is None:
        return default
    return len(deployment.motion.joints) * deployment.settings.step_dt + HOLD
