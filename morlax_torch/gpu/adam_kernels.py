"""Clipping and Adam over one flat vector as two Triton kernels, for CUDA.

`gpu.optimizer.ClippedAdam` has the definition. This module needs Triton, so import it only where
there is CUDA.
"""

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from .optimizer import BETA1, BETA2, EPSILON

BLOCK = 1024  # numbers per program
_LOG1, _LOG2 = tl.constexpr(math.log(BETA1)), tl.constexpr(math.log(BETA2))
_B1, _B2, _EPSILON = tl.constexpr(BETA1), tl.constexpr(BETA2), tl.constexpr(EPSILON)


@triton.jit
def _squares(gradient, squares, steps, size, B: tl.constexpr):
    """Sum the squares of each program's numbers, and count the step, which `_step` only reads."""
    i = tl.program_id(0) * B + tl.arange(0, B)
    g = tl.load(gradient + i, mask=i < size, other=0.0)
    tl.store(squares + tl.program_id(0), tl.sum(g * g, 0))
    if tl.program_id(0) == 0:
        tl.store(steps, tl.load(steps) + 1.0)


@triton.jit
def _step(
    vector,
    gradient,
    means,
    squares_,
    steps,  # ()
    rate,  # ()
    squares,  # of the gradient, one sum per program
    size,
    programs,
    max_norm,
    B: tl.constexpr,
    PROGRAMS: tl.constexpr,  # padded
):
    part = tl.arange(0, PROGRAMS)
    norm = tl.sqrt(tl.sum(tl.load(squares + part, mask=part < programs, other=0.0), 0))
    count = tl.load(steps)
    first = 1.0 - tl.exp(count.to(tl.float64) * _LOG1)
    second = 1.0 - tl.exp(count.to(tl.float64) * _LOG2)
    i = tl.program_id(0) * B + tl.arange(0, B)
    inside = i < size
    g = tl.load(gradient + i, mask=inside, other=0.0) / tl.maximum(norm / max_norm, 1.0)
    m = tl.load(means + i, mask=inside, other=0.0)
    v = tl.load(squares_ + i, mask=inside, other=0.0)
    m += (1.0 - _B1) * (g - m)
    v = _B2 * v + (1.0 - _B2) * g * g
    scale = tl.sqrt(v) / tl.sqrt(second).to(tl.float32) + _EPSILON
    p = tl.load(vector + i, mask=inside, other=0.0)
    p -= tl.load(rate) / first.to(tl.float32) * m / scale
    tl.store(means + i, m, mask=inside)
    tl.store(squares_ + i, v, mask=inside)
    tl.store(vector + i, p, mask=inside)


def step(
    vector: Tensor,
    gradient: Tensor,
    means: Tensor,
    squares: Tensor,
    steps: Tensor,
    rate: Tensor,
    max_norm: float,
) -> None:
    """Scale `gradient` (P,) down to a norm of `max_norm` and take a step of Adam, in place.

    Args:
        vector: the parameters (P,).
        gradient: (P,).
        means: the first moments (P,).
        squares: the second moments (P,).
        steps: the number of steps taken ().
        rate: the learning rate ().
        max_norm: largest norm of the gradient.
    """
    size = len(vector)
    programs = triton.cdiv(size, BLOCK)
    sums = vector.new_empty(programs)
    with torch.cuda.device_of(vector):
        _squares[(programs,)](gradient, sums, steps, size, B=BLOCK)
        _step[(programs,)](
            vector,
            gradient,
            means,
            squares,
            steps,
            rate,
            sums,
            size,
            programs,
            max_norm,
            B=BLOCK,
            PROGRAMS=triton.next_power_of_2(programs),
        )
