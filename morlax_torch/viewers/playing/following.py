"""A robot in C MuJoCo that follows the motion of its export."""

import math
from typing import Any

import mujoco
import numpy as np

from ...envs import MorlaxError
from .robot import Array, Export, Robot, Step

LOW, TILTED = 0.25, 0.8  # m, and of the vertical axis: a fall, as in mjlab's terminations
BODY = mujoco.mjtObj.mjOBJ_BODY


class Follower(Robot):
    """A robot that follows a motion, from a stand in its first frame to its last one.

    `frame` is the one that the robot is to reach by the end of the next control step.
    """

    def __init__(self, deployment: Export, *others: Any):
        assert deployment.motion is not None
        names, self.motion = deployment.settings.key_bodies, deployment.motion
        self._anchor = names.index(deployment.settings.anchor_body)
        self._bodies = [mujoco.mj_name2id(deployment.model, BODY, name) for name in names]
        if -1 in self._bodies:
            raise MorlaxError("key_bodies names a body that the model does not have.")
        super().__init__(deployment, *others)

    def reset(self) -> None:
        """Stand in the first frame."""
        super().reset()
        self.frame = 1
        self.data.ctrl[self._motors] = self.motion.joint_pos[0][self._driven]
        self._place(self.data, 0)

    def step(self, action: Array) -> Step:
        """Move on by a control step; the error (mm) is that of mjlab, relative to the root."""
        aims = self._aims()
        step = super().step(action)
        error = 1000 * np.linalg.norm(self.data.xpos[self._bodies] - aims, axis=1).mean()
        position, turn, aim, aimed = self._anchors()
        stands = abs(position - aim)[2] < LOW and abs(turn - aimed)[2, 2] < TILTED
        self.frame += 1
        over = self.frame >= len(self.motion.joint_pos)
        fallen = not stands or self.broken()
        return step._replace(fallen=fallen, error=float(error), over=over)

    @property
    def seconds(self) -> float:
        return (self.frame - 1) * self.dt

    def ghost(self) -> mujoco.MjData:
        ghost = mujoco.MjData(self.model)
        self._place(ghost, self.frame - 1)
        return ghost

    def _place(self, data: mujoco.MjData, frame: int) -> None:
        motion, base = self.motion, self._height - 2
        data.qpos[base : base + 7] = [*motion.body_pos_w[frame, 0], *motion.body_quat_w[frame, 0]]
        data.qpos[self._qpos], data.qvel[:] = motion.joint_pos[frame], 0.0
        mujoco.mj_forward(self.model, data)

    @property
    def _at(self) -> int:
        return min(self.frame, len(self.motion.joint_pos) - 1)

    def _anchors(self) -> tuple[Array, Array, Array, Array]:
        """Return position (3,) and rotation (3, 3) of the anchor body, and both in the frame."""
        body, motion, matrix = self._bodies[self._anchor], self.motion, np.zeros(9)
        mujoco.mju_quat2Mat(matrix, motion.body_quat_w[self._at, self._anchor])
        aim, aimed = motion.body_pos_w[self._at, self._anchor], matrix.reshape(3, 3)
        return self.data.xpos[body], self.data.xmat[body].reshape(3, 3), aim, aimed

    def _aims(self) -> Array:
        """Return positions (K, 3) of key bodies in the frame, moved and turned to the robot."""
        position, turn, aim, aimed = self._anchors()
        (x, *_), (y, *_), _ = turn @ aimed.T
        cos, sin = np.array([x, y]) / math.hypot(x, y)
        heading = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        around = (self.motion.body_pos_w[self._at] - aim) @ heading.T
        return np.array([*position[:2], aim[2]]) + around

    def _read(self, name: str, params: dict) -> Array:
        position, turn, aim, aimed = self._anchors()
        match name:
            case "motion_command":
                motion, frame = self.motion, self._at
                return np.concatenate([motion.joint_pos[frame], motion.joint_vel[frame]])
            case "motion_anchor_pos_b":
                return (aim - position) @ turn
            case "motion_anchor_ori_b":
                return (turn.T @ aimed)[:, :2].ravel()
        return super()._read(name, params)


def robot_for(deployment: Export, *others: Any) -> Robot:
    """Return a `Follower` if the export has a motion, else a `Robot`, which takes `others`."""
    return (Robot if deployment.motion is None else Follower)(deployment, *others)
