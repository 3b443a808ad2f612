"""Rotations as quaternions (..., 4), w first; sums of products, since training may allow TF32."""

import torch
from torch import Tensor


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the product of `a` and `b`: the rotation `b` followed by `a`."""
    w, x, y, z = a.unbind(-1)
    nx, ny, nz = (-a[..., 1:]).unbind(-1)
    rows = torch.stack([w, nx, ny, nz, x, w, nz, y, y, z, w, nx, z, ny, x, w], -1)
    return (rows.unflatten(-1, (4, 4)) * b[..., None, :]).sum(-1)


def conjugate(q: Tensor) -> Tensor:
    """Return the inverse rotation."""
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def yaw_of(q: Tensor) -> Tensor:
    """Return the yaw angle (...,) in rad."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(w * z + x * y, 0.5 - (y * y + z * z))


def from_angles(angles: Tensor) -> Tensor:
    """Return the rotation of roll, pitch and yaw (..., 3) in rad: about z, then y, then x."""
    half = angles / 2
    roll, pitch, yaw = torch.stack([half.cos(), half.sin()], -1).unbind(-2)
    pairs = roll[..., :, None] * pitch[..., None, :]
    products = (pairs[..., None] * yaw[..., None, None, :]).flatten(-3).unbind(-1)
    ccc, ccs, csc, css, scc, scs, ssc, sss = products
    return torch.stack([ccc - sss, scc + css, csc - scs, ccs + ssc], -1)


def turned(xy: Tensor, yaw: Tensor) -> Tensor:
    """Rotate vectors (..., 2) by an angle (...,) in rad."""
    cos, sin = yaw.cos(), yaw.sin()
    rows = torch.stack([cos, -sin, sin, cos], -1).unflatten(-1, (2, 2))
    return (rows * xy[..., None, :]).sum(-1)


def mapped(matrix: Tensor, values: Tensor) -> Tensor:
    """Map values (N, C) by a matrix (R, C) to (N, R)."""
    return (matrix * values[:, None]).sum(-1)
