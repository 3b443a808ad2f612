"""Quaternions (..., 4), w first."""

import torch
from torch import Tensor


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """First `b`, then `a`."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def conjugate(q: Tensor) -> Tensor:
    """The opposite turn."""
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def positive(q: Tensor) -> Tensor:
    """The same turn with w >= 0."""
    return torch.where(q[..., :1] < 0, -q, q)


def yaw_of(q: Tensor) -> Tensor:
    """(...,): the angle of a turn about z."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_yaw(yaw: Tensor) -> Tensor:
    """The turn about z by an angle (...,)."""
    zero = torch.zeros_like(yaw)
    return torch.stack([(yaw / 2).cos(), zero, zero, (yaw / 2).sin()], -1)


def from_angles(angles: Tensor) -> Tensor:
    """Roll, pitch and yaw (..., 3): the turn about z, then about y, then about x."""
    (cr, cp, cy), (sr, sp, sy) = (f(angles / 2).unbind(-1) for f in (torch.cos, torch.sin))
    return positive(
        torch.stack(
            [
                cr * cp * cy - sr * sp * sy,
                sr * cp * cy + cr * sp * sy,
                cr * sp * cy - sr * cp * sy,
                cr * cp * sy + sr * sp * cy,
            ],
            -1,
        )
    )


def turned(xy: Tensor, yaw: Tensor) -> Tensor:
    """(..., 2) turned by an angle (...,)."""
    (x, y), cos, sin = xy.unbind(-1), yaw.cos(), yaw.sin()
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
