"""The gait cycle of a robot, found in the motion of its joints."""

import mujoco
import numpy as np
from numpy.typing import NDArray

STILL = 0.01  # rad or m: the standard deviation of a joint that does not take part
ALIKE = 0.5  # correlation of a motion with itself, one cycle later
SLOWEST = 2.0  # s of a cycle
PLAIN = 1.0  # s that are shown of a motion without a cycle


def joint_positions(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions (T, J) of the hinges, from states (T, nq), in radians."""
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    return qpos[:, model.jnt_qposadr[hinges]]


def cycle(positions: NDArray[np.float64], dt: float) -> int | None:
    """Return the steps of a gait cycle, or None if the motion does not repeat.

    The cycle is the first peak of the motion's autocorrelation that is nearly as high as the
    highest.

    Args:
        positions: (T, J) of joints.
        dt: duration of a step in seconds.
    """
    moving = positions[:, positions.std(0) > STILL]
    steps = len(moving)
    if steps < 4 or not moving.size:
        return None
    time = np.vander(np.linspace(-1, 1, steps), 2)
    motion = moving - time @ np.linalg.lstsq(time, moving, rcond=None)[0]
    longest = min(steps // 2, round(SLOWEST / dt))
    powers = np.square(motion).sum(1)
    alike = np.ones(longest + 1)
    for lag in range(1, longest + 1):
        both = np.sqrt(powers[lag:].sum() * powers[:-lag].sum())
        alike[lag] = (motion[lag:] * motion[:-lag]).sum() / max(both, 1e-12)
    inner = alike[1:-1]
    peaks = 1 + np.flatnonzero((inner > alike[:-2]) & (inner >= alike[2:]) & (inner > ALIKE))
    apart = peaks[np.minimum.accumulate(alike)[peaks] < 0.5 * alike[peaks]]
    high = apart[alike[apart] > 0.85 * alike[apart].max()] if len(apart) else apart
    return int(high[0]) if len(high) else None


def moments(positions: NDArray[np.float64], dt: float, pictures: int) -> list[int]:
    """Return the control steps of pictures that show the last gait cycle, evenly spaced.

    The first and the last picture show the same phase. A cycle of fewer steps than pictures is
    shown twice; a motion without a cycle for one second.

    Args:
        positions: (T, J) of joints, one row per control step.
        dt: duration of a step in seconds.
        pictures: number of moments, 2 or more.
    """
    last = len(positions) - 1
    span = cycle(positions[len(positions) // 2 :], dt) or round(PLAIN / dt)
    if span < pictures - 1:
        span *= 2
    first = max(0, last - span)
    return np.linspace(first, last, pictures).round().astype(int).tolist()
