"""Motions to follow: read from a file, checked, and brought to mjlab's arrays at a control rate."""

import tempfile
import warnings
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...errors import MorlaxError

KEYS = (
    *("joint_pos", "joint_vel", "body_pos_w", "body_quat_w"),
    *("body_lin_vel_w", "body_ang_vel_w"),
)
FASTEST, FASTEST_ROOT = 50.0, 20.0  # rad/s of a joint or the root, m/s; faster is a jump


@cache
def prepared(path: Path, changed: int, fps: float, rate: float, robot: Any) -> tuple[Path, int]:
    """Return a file in mjlab's format with one frame per control step, and the number of frames.

    That is `path` itself where it has this format and rate, else a temporary file of this process.

    Args:
        changed: time of the file's last change.
        fps, rate: frames per second of a CSV file; control steps per second.
        robot: makes its MjSpec.
    """
    model = robot().compile()
    if path.suffix.lower() == ".csv":
        qpos = _from_csv(path, model)
    else:
        qpos, fps = _from_npz(path, model)
    _check(path, qpos, fps, model)
    if path.suffix.lower() != ".csv" and fps == rate:
        return path, len(qpos)
    qpos = resampled(qpos, fps, rate, model)
    file = Path(tempfile.mkdtemp(dir=_folder().name), f"{path.stem}.npz")
    np.savez(file, fps=[rate], **arrays(qpos, rate, model))
    return file, len(qpos)


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="morlax-motions-")


def _from_csv(path: Path, model: mujoco.MjModel) -> np.ndarray:
    """Read positions (T, nq); the file has the root's x y z, quaternion x y z w, then joints."""
    try:
        with warnings.catch_warnings(action="ignore"):  # that it is empty
            rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise MorlaxError(f"{path} is not a CSV file of numbers: {error}.") from None
    if rows.size and rows.shape[1] != model.nq:
        raise MorlaxError(
            f"{path} has {rows.shape[1]} columns, but a motion of this robot {model.nq}: x y z of "
            f"the root, its quaternion x y z w, and the angles of {model.nq - 7} joints."
        )
    return rows[:, [0, 1, 2, 6, 3, 4, 5, *range(7, model.nq)]] if rows.size else rows


def _from_npz(path: Path, model: mujoco.MjModel) -> tuple[np.ndarray, float]:
    """Read positions (T, nq) and the frame rate from a file in mjlab's format."""
    try:
        with np.load(path) as file:
            motion = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile):
        raise MorlaxError(f"{path} is not a motion: it is neither a CSV nor an npz file.") from None
    if missing := [name for name in (*KEYS, "fps") if name not in motion]:
        raise MorlaxError(
            f"{path} lacks {', '.join(missing)}: a motion in mjlab's format has "
            f"{', '.join(KEYS)}, and its frame rate fps."
        )
    joints, bodies = model.nq - 7, model.nbody - 1
    positions, rotations, angles = motion["body_pos_w"], motion["body_quat_w"], motion["joint_pos"]
    of_motion = *angles.shape[1:], *positions.shape[1:2]
    if of_motion != (joints, bodies):
        raise MorlaxError(
            f"{path} is a motion of another robot: it has {angles.shape[-1]} joints and "
            f"{positions.shape[1]} bodies, and this robot {joints} and {bodies}."
        )
    fps = float(np.ravel(motion["fps"])[0])
    if not fps > 0:
        raise MorlaxError(f"{path} has the frame rate {fps:g}: fps must be above 0.")
    if len(angles) > 1:
        moved, told = (np.linalg.norm(x) for x in (np.diff(angles, axis=0) * fps, motion[KEYS[1]]))
        if not 0.7 * moved <= told <= 1.4 * moved:
            raise MorlaxError(
                f"{path} says {fps:g} frames per second, but joint_vel is that of about "
                f"{fps * told / max(moved, 1e-9):.0f}: correct its fps."
            )
    return np.concatenate([positions[:, 0], rotations[:, 0], angles], 1).astype(float), fps


def _check(path: Path, qpos: np.ndarray, fps: float, model: mujoco.MjModel) -> None:
    if len(qpos) < 2:
        raise MorlaxError(f"{path} is empty: a motion has at least two frames.")
    finite = np.isfinite(qpos).all(1)
    if not finite.all():
        raise MorlaxError(f"{path} has a number that is not finite in frame {finite.argmin()}.")
    if abs(np.linalg.norm(qpos[:, 3:7], axis=1) - 1).max() > 0.01:
        raise MorlaxError(f"{path} has a quaternion of the root that is not of length one.")
    moves = abs(_differences(qpos[:-1], qpos[1:], 1 / fps, model))
    for speeds, limit, what in (
        (moves[:, :3].max(1), FASTEST_ROOT, "the root at {:.0f} m/s"),
        (moves[:, 3:].max(1), FASTEST, "a joint or the root at {:.0f} rad/s"),
    ):
        if speeds.max() > limit:
            raise MorlaxError(
                f"{path} jumps after frame {speeds.argmax()}: it moves "
                f"{what.format(speeds.max())}, at {fps:g} frames per second (--task.motion-fps)."
            )


def _differences(
    before: np.ndarray, after: np.ndarray, seconds: float | np.ndarray, model: mujoco.MjModel
) -> np.ndarray:
    """Return the velocities (T, nv) between positions (T, nq)."""
    velocities = np.zeros((len(before), model.nv))
    for velocity, first, second in zip(velocities, before, after, strict=True):
        mujoco.mj_differentiatePos(model, velocity, 1.0, first, second)
    return velocities / np.reshape(seconds, (-1, 1))


def resampled(qpos: np.ndarray, fps: float, rate: float, model: mujoco.MjModel) -> np.ndarray:
    """Interpolate positions (T, nq): joints linearly, the root's orientation on the sphere."""
    last = len(qpos) - 1
    places = np.arange(int(last / fps * rate + 1e-6) + 1) / rate * fps
    index = places.astype(int).clip(max=last - 1)
    moves = _differences(qpos[index], qpos[index + 1], 1.0, model)
    result = qpos[index]
    for row, move, share in zip(result, moves, places - index, strict=True):
        mujoco.mj_integratePos(model, row, move, share)
    return result


def arrays(qpos: np.ndarray, rate: float, model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return mjlab's arrays (T, ...) of positions (T, nq), by forward kinematics.

    Velocities are central differences; angular velocities those of quaternions.
    """
    index = np.arange(len(qpos))
    before, after = (index - 1).clip(min=0), (index + 1).clip(max=len(qpos) - 1)
    qvel = _differences(qpos[before], qpos[after], (after - before) / rate, model)
    data, twist = mujoco.MjData(model), np.zeros(6)
    poses, twists = np.zeros((len(qpos), model.nbody, 7)), np.zeros((len(qpos), model.nbody, 6))
    for frame in index:
        data.qpos, data.qvel = qpos[frame], qvel[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        poses[frame] = np.concatenate([data.xpos, data.xquat], 1)
        for body in range(1, model.nbody):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            twists[frame, body] = twist
    parts = (
        *(qpos[:, 7:], qvel[:, 6:], poses[:, 1:, :3], poses[:, 1:, 3:]),
        *(twists[:, 1:, 3:], twists[:, 1:, :3]),
    )
    return dict(zip(KEYS, (part.astype(np.float32) for part in parts), strict=True))
