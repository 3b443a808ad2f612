"""Simulation of planned gaits with joint servos and a minimal balance controller."""

import mujoco
import numpy as np
from gait_library import Gait
from gait_planner import GRAVITY, STANCE, Motion, Planner
from numpy.typing import NDArray

from morlax_torch.envs.robots.bruce import model as bruce

CONTROL_STEPS = 20  # per step of a gait, 20 ms each
FALLEN = 0.2  # m; a robot with a lower base has fallen
ANKLE = 2.4  # rad/m: gain from the capture point's error to the stance ankle
PLACEMENT = 0.5  # rad/m: gain from the capture point's error to the swing hip


class Walker:
    """Walks gaits: servos track the joints, and a balance controller corrects errors.

    The controller compares the capture point (where a pendulum would come to rest), relative to the
    stance foot, with that of the gait. The stance ankle pushes it back, and the swing foot lands
    closer to it.

    Args:
        planner: planned the gaits.
    """

    def __init__(self, planner: Planner):
        self.planner, self.model = planner, planner.model
        self.data = mujoco.MjData(self.model)
        self._omega = np.sqrt(GRAVITY / planner.constants.com_height)
        self._from_joints = bruce.crank_from_joints(self.model)
        self._to_motors = bruce.from_crank(bruce.MOTORS)
        self._stiffness = self.model.actuator_gainprm[:16, 0]
        duration = planner.constants.step_time / CONTROL_STEPS
        self._substeps = round(duration / self.model.opt.timestep)

    def walk(self, gait: Gait, steps: int) -> int:
        """Return the number of steps walked before falling, at most `steps`."""
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
                balance[swing + 4] = -reach * ahead  # keeps the sole level
                data.ctrl[:16] = servo[phase, k] + self._to_motors @ balance
                mujoco.mj_step(self.model, data, nstep=self._substeps)
                if data.qpos[2] < FALLEN:
                    return step
        return steps

    def _expected(self, motion: Motion) -> NDArray[np.float64]:
        """Return the capture points (2, S, 2) of a gait in m."""
        expected = np.zeros((*motion.qpos.shape[:2], 2))
        for phase, k in np.ndindex(*expected.shape[:2]):
            self.data.qpos[:], self.data.qvel[:] = motion.qpos[phase, k], motion.qvel[phase, k]
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            mujoco.mj_comVel(self.model, self.data)
            expected[phase, k] = self._capture_point(STANCE[phase])
        return expected

    def _capture_point(self, stance: str) -> NDArray[np.float64]:
        """Return the capture point (2,) in m, forward and to the left of the stance sole.

        Directions are relative to the torso's heading.
        """
        data = self.data
        mujoco.mj_subtreeVel(self.model, data)
        point = data.subtree_com[1] + data.subtree_linvel[1] / self._omega
        x, y, _ = point - data.site(f"{stance}_sole").xpos
        cos, sin = data.xmat[1, [0, 3]] / np.hypot(*data.xmat[1, [0, 3]])
        return np.array([cos * x + sin * y, cos * y - sin * x])
