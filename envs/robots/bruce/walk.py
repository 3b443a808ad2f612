"""A planned gait, walked in simulation by servos and as little balance as that takes."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from . import model as bruce
from .planner import GRAVITY, STANCE, Gait, Motion, Planner

CONTROL_STEPS = 20  # of 20 ms, in each step of a gait
FALLEN = 0.2  # metres: a lower base has fallen
ANKLE = 2.4  # rad of the stance ankle for each metre that the capture point is ahead
PLACEMENT = 0.5  # rad of the swinging hip, likewise


class Walker:
    """Walks gaits: it holds the joints of a gait by their servos and catches its own errors.

    The capture point (where a pendulum would come to rest) is compared with the gait's, seen from
    the stance foot. The stance ankle pushes it back, and the swinging foot lands nearer to it.
    """

    def __init__(self, planner: Planner):
        self.planner, self.model = planner, planner.model
        self.data = mujoco.MjData(self.model)
        self._omega = np.sqrt(GRAVITY / planner.constants.com_height)
        self._from_joints = bruce.crank_from_joints(self.model)
        self._to_motors = bruce.motors_from_crank()
        self._stiffness = self.model.actuator_gainprm[:16, 0]
        duration = planner.constants.step_time / CONTROL_STEPS
        self._substeps = round(duration / self.model.opt.timestep)

    def walk(self, gait: Gait, steps: int) -> int:
        """How many steps of a gait it makes before it falls, at most `steps`."""
        data = self.data
        motion = self.planner.motion(gait, np.arange(CONTROL_STEPS) / CONTROL_STEPS)
        joints = motion.qpos[..., 7:] @ self._from_joints.T
        servo = joints @ self._to_motors.T + self.planner.loads(motion).torque / self._stiffness
        expected = self._expected(motion)
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = motion.qpos[0, 0], motion.qvel[0, 0]
        mujoco.mj_forward(self.model, data)
        for step in range(steps):
            phase = step % 2
            stance, swing = (0, 5) if STANCE[phase] == "right" else (5, 0)
            for k in range(CONTROL_STEPS):
                ahead, aside = self._capture_point(STANCE[phase]) - expected[phase, k]
                reach = PLACEMENT * min(2 * k / CONTROL_STEPS, 1)
                balance = np.zeros(16)
                balance[stance + 4] = -ANKLE * ahead
                balance[swing + 1] = reach * ahead
                balance[swing + 2] = reach * aside
                balance[swing + 4] = -reach * ahead  # the sole stays level
                data.ctrl[:16] = servo[phase, k] + self._to_motors @ balance
                mujoco.mj_step(self.model, data, nstep=self._substeps)
                if data.qpos[2] < FALLEN:
                    return step
        return steps

    def _expected(self, motion: Motion) -> NDArray[np.float64]:
        """(2, S, 2): the capture points of a gait."""
        expected = np.zeros((*motion.qpos.shape[:2], 2))
        for phase, k in np.ndindex(*expected.shape[:2]):
            self.data.qpos[:], self.data.qvel[:] = motion.qpos[phase, k], motion.qvel[phase, k]
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_comVel(self.model, self.data)
            expected[phase, k] = self._capture_point(STANCE[phase])
        return expected

    def _capture_point(self, stance: str) -> NDArray[np.float64]:
        """(2,) ahead and to the left of the stance sole, as the torso is heading."""
        data = self.data
        mujoco.mj_subtreeVel(self.model, data)
        point = data.subtree_com[1] + data.subtree_linvel[1] / self._omega
        x, y, _ = point - data.site(f"{stance}_sole").xpos
        cos, sin = data.xmat[1, [0, 3]] / np.hypot(*data.xmat[1, [0, 3]])
        return np.array([cos * x + sin * y, cos * y - sin * x])
