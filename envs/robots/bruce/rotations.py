"""Rotations as quaternions (..., 4), w first."""

import torch
from torch import Tensor


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product of `a` and `b`: the rotation `b` followed by `a`."""
    (aw, av), (bw, bv) = a.split([1, 3], -1), b.split([1, 3], -1)
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    v = torch.addcmul(torch.addcmul(torch.linalg.cross(av, bv), aw, bv), bw, av)
    return torch.cat([w, v], -1)


def conjugate(q: Tensor) -> Tensor:
    """Return the inverse rotation."""
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def positive(q: Tensor) -> Tensor:
    """Return the same rotation with w >= 0."""
    return torch.where(q[..., :1] < 0, -q, q)


def yaw_of(q: Tensor) -> Tensor:
    """Return the yaw angle (...,) in rad."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_yaw(yaw: Tensor) -> Tensor:
    """Return the rotation about z by an angle (...,) in rad."""
    zero = torch.zeros_like(yaw)
    return torch.stack([(yaw / 2).cos(), zero, zero, (yaw / 2).sin()], -1)


def from_angles(angles: Tensor) -> Tensor:
    """Return the rotation of roll, pitch and yaw (..., 3) in rad: about z, then y, then x."""
    half = torch.stack([(angles / 2).cos(), (angles / 2).sin()], -1)
    roll, pitch, yaw = half.unbind(-2)
    pairs = roll[..., :, None] * pitch[..., None, :]
    products = (pairs[..., None] * yaw[..., None, None, :]).flatten(-3).unbind(-1)
    ccc, ccs, csc, css, scc, scs, ssc, sss = products
    return positive(torch.stack([ccc - sss, scc + css, csc - scs, ccs + ssc], -1))


def turned(xy: Tensor, yaw: Tensor) -> Tensor:
    """Rotate vectors (..., 2) by an angle (...,) in rad."""
    (x, y), cos, sin = xy.unbind(-1), yaw.cos(), yaw.sin()
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
