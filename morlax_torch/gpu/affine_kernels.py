"""The hypernetwork's affine map in one Triton kernel forward and one backward, for CUDA.

H(w) = M f(w) + b makes many parameters from few features of few trade-offs, a product so flat that
memory bounds it: each program reads its rows of M once, for all trade-offs, in full precision.

`torch.addmm` is the definition. This module needs Triton, so import it only where there is CUDA.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

ROWS = 128  # parameters per program


@triton.jit(do_not_specialize=("K", "P"))
def _forward(features, weight, bias, out, K, P, F: tl.constexpr, FP: tl.constexpr, B: tl.constexpr):
    row, column = tl.program_id(0) * B + tl.arange(0, B), tl.arange(0, FP)
    inside = (row < P)[:, None] & (column < F)[None, :]
    m = tl.load(weight + row[:, None] * F + column[None, :], mask=inside, other=0.0)
    b = tl.load(bias + row, mask=row < P, other=0.0)
    for k in range(K):
        f = tl.load(features + k * F + column, mask=column < F, other=0.0)
        tl.store(out + k * P + row, b + tl.sum(m * f[None, :], 1), mask=row < P)


@triton.jit(do_not_specialize=("K", "P"))
def _backward(
    slope,  # (K, P)
    features,  # (K, F)
    weight,  # (P, F)
    by_weight,  # (P, F)
    by_bias,  # (P,)
    by_features,  # (programs, K, F), the part of each program's rows
    K,
    P,
    F: tl.constexpr,
    FP: tl.constexpr,
    B: tl.constexpr,
):
    row, column = tl.program_id(0) * B + tl.arange(0, B), tl.arange(0, FP)
    inside = (row < P)[:, None] & (column < F)[None, :]
    m = tl.load(weight + row[:, None] * F + column[None, :], mask=inside, other=0.0)
    dm = tl.zeros([B, FP], tl.float32)
    db = tl.zeros([B], tl.float32)
    part = by_features + tl.program_id(0) * K * F + column
    for k in range(K):
        g = tl.load(slope + k * P + row, mask=row < P, other=0.0)
        f = tl.load(features + k * F + column, mask=column < F, other=0.0)
        dm += g[:, None] * f[None, :]
        db += g
        tl.store(part + k * F, tl.sum(g[:, None] * m, 0), mask=column < F)
    tl.store(by_weight + row[:, None] * F + column[None, :], dm, mask=inside)
    tl.store(by_bias + row, db, mask=row < P)


@triton.jit(do_not_specialize=("K", "programs"))
def _sum(parts, total, K, programs, F: tl.constexpr, FP: tl.constexpr, B: tl.constexpr):
    """Sum (programs, K, F) to (K, F), a trade-off per program."""
    k, row, column = tl.program_id(0), tl.arange(0, B), tl.arange(0, FP)
    found = tl.zeros([B, FP], tl.float32)
    for first in range(0, programs, B):
        inside = (first + row < programs)[:, None] & (column < F)[None, :]
        place = ((first + row) * K + k)[:, None] * F + column[None, :]
        found += tl.load(parts + place, mask=inside, other=0.0)
    tl.store(total + k * F + column, tl.sum(found, 0), mask=column < F)


class _Affine(torch.autograd.Function):
    """Features (K, F) @ weight (P, F).T + bias (P,), differentiable by all three."""

    @staticmethod
    def forward(ctx, features: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        (K, F), P = features.shape, len(weight)
        out = features.new_empty(K, P)
        with torch.cuda.device_of(features):
            _forward[(triton.cdiv(P, ROWS),)](
                features, weight, bias, out, K, P, F=F, FP=triton.next_power_of_2(F), B=ROWS
            )
        ctx.save_for_backward(features, weight)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, slope: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        features, weight = ctx.saved_tensors
        (K, F), P = features.shape, len(weight)
        programs = triton.cdiv(P, ROWS)
        by_weight, by_bias = torch.empty_like(weight), weight.new_empty(P)
        parts, by_features = features.new_empty(programs, K, F), features.new_empty(K, F)
        padded = triton.next_power_of_2(F)
        with torch.cuda.device_of(slope):
            _backward[(programs,)](
                slope.contiguous(),
                features,
                weight,
                by_weight,
                by_bias,
                parts,
                K,
                P,
                F=F,
                FP=padded,
                B=ROWS,
            )
            _sum[(K,)](parts, by_features, K, programs, F=F, FP=padded, B=ROWS)
        return by_features, by_weight, by_bias


affine = _Affine.apply
