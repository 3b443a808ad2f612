"""Motions to follow: read from files, checked, and brought to mjlab's arrays at a control rate."""

import tempfile
import warnings
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...errors import MorlaxError, warn_user

ENDINGS = (".npz", ".csv")
BODIES = ("body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")
KEYS = ("joint_pos", "joint_vel", *BODIES)


@cache
def prepared(
    path: Path, changed: int, fps: float, stand: float, rate: float, robot: Any
) -> tuple[Path, int]:
    """Return a file in mjlab's format with one frame per control step, and the number of frames.

    That is `path`, last `changed` then, where it has this format and `rate`, else a temporary file
    of this process. `fps` is the rate of a CSV file; the last frame lasts `stand` seconds longer;
    `robot` makes the robot's MjSpec.
    """
    model, is_csv = robot().compile(), path.suffix.lower() == ".csv"
    qpos, fps = (_from_csv(path, model), fps) if is_csv else _from_npz(path, model)
    _check(path, qpos, fps, model)
    if np.isclose(fps, rate) and not is_csv and not stand:
        return path, len(qpos)
    qpos = resampled(qpos, fps, rate, model)
    qpos = np.concatenate([qpos, qpos[-1:].repeat(round(stand * rate), 0)])
    file = Path(tempfile.mkdtemp(dir=_folder().name), f"{path.stem}.npz")
    named: dict[str, Any] = {"fps": [rate], **arrays(qpos, rate, model)}
    np.savez(file, **named)
    return file, len(qpos)


def files(name: str) -> list[Path]:
    """Return a file, or the motions of a folder in the order of their names; none of no name."""
    path = Path(name)
    if not name or not path.is_dir():
        return [path] if path.is_file() else []
    return sorted(file for file in path.iterdir() if file.suffix.lower() in ENDINGS)


@cache
def joined(*paths: Path) -> Path:
    """Return a file of several motions in mjlab's format, one after the other."""
    motions = [np.load(path) for path in paths]
    lengths = [len(motion["joint_pos"]) for motion in motions]
    named: dict[str, Any] = {"fps": motions[0]["fps"], "lengths": lengths}
    named |= {name: np.concatenate([motion[name] for motion in motions]) for name in KEYS}
    file = Path(tempfile.mkdtemp(dir=_folder().name), "motions.npz")
    np.savez(file, **named)
    return file


def bounds(path: str) -> list[int]:
    """Return the first frame of each motion of a file, and the number of all frames."""
    with np.load(path) as file:
        lengths = file["lengths"] if "lengths" in file else [len(file["joint_pos"])]
    return [0, *np.cumsum(lengths).tolist()]


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="morlax-motions-")


def _from_csv(path: Path, model: mujoco.MjModel) -> np.ndarray:
    """Read positions (T, nq); the file has the root's x y z, quaternion x y z w, then joints."""
    try:
        with warnings.catch_warnings(action="ignore"):  # that it is empty
            rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError:
        raise MorlaxError(
            f"{path} is not a CSV file of numbers, without a header and as many in each line."
        ) from None
    if rows.size and rows.shape[1] != model.nq:
        raise MorlaxError(
            f"{path} has {rows.shape[1]} columns, but a motion of this robot {model.nq}: x y z of "
            f"the root, its quaternion x y z w, and the angles of {model.nq - 7} joints."
        )
    if not rows.size:
        return rows
    x, y, z, _ = rows[:, 3:7].T  # the vertical part of the robot's up axis, in either order:
    if (1 - 2 * (x**2 + y**2)).mean() < 0 < (1 - 2 * (y**2 + z**2)).mean():
        warn_user(f"{path} shows a robot upside down: is its quaternion w x y z, not x y z w?")
    return rows[:, [0, 1, 2, 6, 3, 4, 5, *range(7, model.nq)]]


def _from_npz(path: Path, model: mujoco.MjModel) -> tuple[np.ndarray, float]:
    """Read positions (T, nq) and the frame rate from a file in mjlab's format."""
    try:
        with np.load(path) as file:
            names = {*KEYS, "fps"} & {*file.files}
            motion = {name: np.atleast_1d(file[name].astype(float)) for name in names}
    except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile):
        raise MorlaxError(f"{path} is neither a CSV nor an npz file.") from None
    if missing := [name for name in (*KEYS, "fps") if name not in motion]:
        raise MorlaxError(
            f"{path} lacks {', '.join(missing)}: a motion in mjlab's format has {', '.join(KEYS)} "
            "and its frame rate, fps."
        )
    if len({len(motion[name]) for name in KEYS}) > 1 or not motion["fps"].size:
        raise MorlaxError(
            f"{path} needs as many frames of {', '.join(KEYS)}, and a number in fps: write it anew."
        )
    angles, speeds, positions, rotations = (motion[name] for name in KEYS[:4])
    sizes, expected = (angles.shape[-1], positions.shape[1]), (model.nq - 7, model.nbody - 1)
    if sizes != expected:
        raise MorlaxError(
            f"{path} is a motion of another robot: it has {sizes[0]} joints and {sizes[1]} bodies, "
            f"and this robot {expected[0]} and {expected[1]}."
        )
    fps = motion["fps"].flat[0]
    change, speed = np.linalg.norm(np.diff(angles, axis=0)), np.linalg.norm(speeds[:-1])
    if not fps > 0 or speed < 0.7 * fps * change or speed > 1.4 * fps * change:
        raise MorlaxError(
            f"{path} says {fps:g} frames per second, but its joint_vel is that of about "
            f"{speed / max(change, 1e-9):.0f}: correct its fps."
        )
    return np.concatenate([positions[:, 0], rotations[:, 0], angles], 1), fps


def _check(path: Path, qpos: np.ndarray, fps: float, model: mujoco.MjModel) -> None:
    if len(qpos) < 2:
        raise MorlaxError(f"{path} is empty: a motion has at least two frames.")
    finite = np.isfinite(qpos).all(1)
    if not finite.all():
        raise MorlaxError(f"{path} has a number that is not finite in frame {finite.argmin()}.")
    if abs(np.linalg.norm(qpos[:, 3:7], axis=1) - 1).max() > 0.01:
        raise MorlaxError(f"{path} has a quaternion of the root that is not of length one.")
    speeds = abs(_moves(qpos[:-1], qpos[1:], model)) * fps
    for part, fastest, unit in ((speeds[:, :3], 20, "m/s"), (speeds[:, 3:], 50, "rad/s")):
        if part.max() > fastest:
            raise MorlaxError(
                f"{path} jumps after frame {part.max(1).argmax()}, at {part.max():.0f} {unit} if "
                f"it has {fps:g} frames per second: at most {fastest} are possible "
                "(--task.motion-fps is the rate of a CSV file)."
            )


def _moves(before: np.ndarray, after: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """Return what leads in a second from positions (T, nq) to others: velocities (T, nv)."""
    moves = np.zeros((len(before), model.nv))
    for move, first, second in zip(moves, before, after, strict=True):
        mujoco.mj_differentiatePos(model, move, 1.0, first, second)
    return moves


def resampled(qpos: np.ndarray, fps: float, rate: float, model: mujoco.MjModel) -> np.ndarray:
    """Interpolate positions (T, nq): joints linearly, the root's orientation on the sphere."""
    last = len(qpos) - 1
    places = np.arange(int(last / fps * rate + 1e-6) + 1) / rate * fps
    index = places.astype(int).clip(max=last - 1)
    moves = _moves(qpos[index], qpos[index + 1], model)
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
    qvel = _moves(qpos[before], qpos[after], model) * rate / (after - before)[:, None]
    data, twist = mujoco.MjData(model), np.zeros(6)
    bodies = np.zeros((len(qpos), model.nbody - 1, 13))
    for frame in index:
        data.qpos, data.qvel = qpos[frame], qvel[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for body, row in enumerate(bodies[frame], 1):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            row[:] = *data.xpos[body], *data.xquat[body], *twist[3:], *twist[:3]
    parts = qpos[:, 7:], qvel[:, 6:], *np.split(bodies, [3, 7, 10], 2)
    return {name: part.astype(np.float32) for name, part in zip(KEYS, parts, strict=True)}
