"""Acceptance limits for the gaits of the library."""

import mujoco
import numpy as np
from gait_library import Gait
from gait_planner import STANCE, Motion, Planner
from numpy.typing import NDArray

from morlax_torch.envs.robots.bruce import model as bruce

INSTANTS = 81  # samples per step
STEPS = 25  # to walk in simulation without falling: 10 s
KNEE, CRANK = 3, 4  # indices in the five joints of a leg

LIMITS: dict[str, tuple[float, float]] = {
    "joint_jump": (0.0, 1e-6),  # rad, between steps
    "base_jump": (0.0, 1e-6),  # m
    "joint_speed_jump": (0.0, 0.5),  # rad/s
    "stance_drift": (0.0, 1e-3),  # m
    "apex": (0.03, 0.05),  # m, highest point of the swing sole
    "clearance": (0.012, 0.05),  # m, lowest point of the swing sole from 0.2 to 0.8 of a step
    "touchdown_speed": (0.0, 0.1),  # m/s
    "pivot_sagittal": (0.0, 0.025),  # m, error of the center of pressure
    "pivot_lateral": (0.0, 0.01),  # m
    "friction": (0.0, 0.5),  # ratio of horizontal to vertical force
    "yaw_moment": (0.0, 1.8),  # N m about the sole; a larger moment would turn it on the floor
    "torque": (0.0, 5.0),  # N m, of a leg motor
    "knee_min": (-1.6, 0.0),  # rad
    "knee_max": (-1.6, -0.2),
    "crank": (0.0, 1.3),  # rad from the middle of its range
    "reach": (0.0, 0.5),  # rad from the default pose; actions reach 0.6
    "joint_speed": (0.0, 5.0),  # rad/s
    "velocity_error": (0.0, 1e-3),  # m/s, mean over two steps
}
MIN_WALKED = 140  # of the library's 153 gaits must walk STEPS steps in simulation


def measure(planner: Planner, gait: Gait, vx: float, vy: float) -> dict[str, float]:
    """Measure a gait by the names of `LIMITS`, in their units.

    Args:
        planner: planned the gait.
        gait: the gait to measure.
        vx: commanded velocity forward in m/s.
        vy: commanded velocity to the left in m/s.
    """
    c = planner.constants
    s = np.linspace(0, 1, INSTANTS)
    motion = planner.motion(gait, s)
    loads = planner.loads(motion)
    joints = motion.qpos[..., 7:] @ bruce.crank_from_joints(planner.model).T
    speeds = motion.qvel[..., 6:] @ bruce.crank_from_joints(planner.model).T
    legs = joints[..., : bruce.NUM_LEG_JOINTS].reshape(2, INSTANTS, 2, 5)
    stance, swing, swing_velocity = _feet(planner, motion)
    # base displacement from the frame of one stance foot to that of the next
    moved = motion.qpos[:, -1, :3] - motion.qpos[::-1, 0, :3]
    landed = swing[:, -1] - stance[:, -1]
    middle = (s > 0.2 - 1e-9) & (s < 0.8 + 1e-9)
    off = np.abs(loads.pivot - [c.pivot, 0.0])
    velocity = moved.sum(0)[:2] / (2 * c.step_time)
    return {
        "joint_jump": np.abs(joints[:, -1] - joints[::-1, 0]).max(),
        "base_jump": np.abs(moved - landed).max(),
        "joint_speed_jump": np.abs(speeds[:, -1] - speeds[::-1, 0]).max(),
        "stance_drift": np.abs(stance).max(),
        "apex": swing[..., 2].max(1).min(),
        "clearance": swing[:, middle, 2].min(),
        "touchdown_speed": np.linalg.norm(swing_velocity[:, -1], axis=-1).max(),
        "pivot_sagittal": off[..., 0].max(),
        "pivot_lateral": off[..., 1].max(),
        "friction": (np.linalg.norm(loads.force[..., :2], axis=-1) / loads.force[..., 2]).max(),
        "yaw_moment": np.abs(loads.yaw_moment).max(),
        "torque": np.abs(loads.torque[..., : bruce.NUM_LEG_JOINTS]).max(),
        "knee_min": legs[..., KNEE].min(),
        "knee_max": legs[..., KNEE].max(),
        "crank": np.abs(legs[..., CRANK]).max(),
        "reach": np.abs(joints - bruce.DEFAULT_POSE).max(),
        "joint_speed": np.abs(speeds).max(),
        "velocity_error": np.abs(velocity - [vx, vy]).max(),
    }


def _feet(
    planner: Planner, motion: Motion
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the stance and swing sole positions and the swing sole velocity, (2, S, 3) each."""
    model, data = planner.model, mujoco.MjData(planner.model)
    feet = np.zeros((3, *motion.qpos.shape[:2], 3))
    jacobian = np.zeros((3, model.nv))
    for phase, k in np.ndindex(*motion.qpos.shape[:2]):
        data.qpos[:] = motion.qpos[phase, k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        stance, swing = (
            model.site(f"{side}_sole").id for side in (STANCE[phase], STANCE[1 - phase])
        )
        mujoco.mj_jacSite(model, data, jacobian, None, swing)
        feet[:, phase, k] = (
            data.site_xpos[stance],
            data.site_xpos[swing],
            jacobian @ motion.qvel[phase, k],
        )
    return feet[0], feet[1], feet[2]
