"""A small motion of our own: the G1 squats and waves, made by kinematics."""

import functools
from pathlib import Path

import mujoco
import numpy as np

STANCE = {"hip_pitch": -0.312, "knee": 0.669, "ankle_pitch": -0.363, "elbow": 0.6}  # rad


@functools.cache
def g1() -> mujoco.MjModel:
    """Return mjlab's G1 without a scene: a free joint, 29 hinges, 30 bodies."""
    from mjlab.asset_zoo.robots import get_g1_robot_cfg

    return get_g1_robot_cfg().spec_fn().compile()


def squat(seconds: float = 2.0, fps: float = 50) -> np.ndarray:
    """Return positions (T, 36) of a squat with a wave: root x y z, quaternion w x y z, joints.

    The feet stay where they are.
    """
    model, times = g1(), np.arange(round(seconds * fps)) / fps
    data = mujoco.MjData(model)
    qpos = np.zeros((len(times), model.nq))
    down = 0.25 * (1 - np.cos(2 * np.pi * times / seconds))  # rad; the knee bends twice as far
    bends = {"hip_pitch": -down, "knee": 2 * down, "ankle_pitch": -down, "elbow": 0 * down}
    for side in ("left", "right"):
        for name, angle in STANCE.items():
            qpos[:, model.joint(f"{side}_{name}_joint").qposadr[0]] = angle + bends[name]
    wave = model.joint("right_shoulder_roll_joint").qposadr[0]
    qpos[:, wave] = -0.5 + 0.3 * np.sin(4 * np.pi * times / seconds)
    qpos[:, model.joint("left_shoulder_roll_joint").qposadr[0]] = 0.2
    qpos[:, 2:4] = 0.76, 1.0
    feet = np.zeros((len(times), 3))
    for row, foot in zip(qpos, feet, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        foot[:] = data.body("left_ankle_roll_link").xpos
    qpos[:, :3] += feet[0] - feet
    return qpos


def write_squat(path: Path, seconds: float = 2.0, fps: float = 50) -> Path:
    """Write the squat in mjlab's npz format."""
    return write_motion(path, squat(seconds, fps), fps)


def write_motion(path: Path, qpos: np.ndarray, fps: float) -> Path:
    """Write positions (T, 36) in mjlab's npz format; velocities are differences of frames."""
    model = g1()
    data = mujoco.MjData(model)
    poses = []
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        poses.append(np.concatenate([data.xpos[1:], data.xquat[1:]], 1))
    poses = np.stack(poses)
    turning, last = np.zeros_like(poses[..., :3]), len(qpos) - 1
    for frame, body in np.ndindex(*turning.shape[:2]):
        first, second = max(frame - 1, 0), min(frame + 1, last)
        before, after = poses[first, body, 3:], poses[second, body, 3:]
        spin = turning[frame, body]
        mujoco.mju_subQuat(spin, after, before)  # in the body's frame
        mujoco.mju_rotVecQuat(spin, spin * fps / (second - first), before)
    np.savez(
        path,
        fps=[fps],
        joint_pos=qpos[:, 7:],
        joint_vel=np.gradient(qpos[:, 7:], 1 / fps, axis=0),
        body_pos_w=poses[..., :3],
        body_quat_w=poses[..., 3:],
        body_lin_vel_w=np.gradient(poses[..., :3], 1 / fps, axis=0),
        body_ang_vel_w=turning,
    )
    return path
