"""Clipping and Adam as two Triton kernels, for CUDA.

`gpu.optimizer.step` is their definition. This module needs Triton, so import it only where there is
CUDA.
"""

import math
from itertools import accumulate

import torch
import triton
import triton.language as tl

from ..configuration.sections import DECAYS, EPSILON

BLOCK = 1024  # numbers per program
_DECAY1, _DECAY2, _EPSILON = tl.constexpr(DECAYS[0]), tl.constexpr(DECAYS[1]), tl.constexpr(EPSILON)
_LOG1, _LOG2 = tl.constexpr(math.log(DECAYS[0])), tl.constexpr(math.log(DECAYS[1]))


@triton.jit
def _gradient(gradients, FIRSTS: tl.constexpr, SIZES: tl.constexpr, B: tl.constexpr):
    """Load a program's numbers of its one gradient; return where they are in the vector, too."""
    program = tl.program_id(0)
    i = tl.zeros([B], tl.int32)
    inside = i < 0
    g = tl.zeros([B], tl.float32)
    start = 0
    for j in tl.static_range(len(SIZES)):
        if (program >= FIRSTS[j]) & (program < FIRSTS[j + 1]):
            cell = (program - FIRSTS[j]) * B + tl.arange(0, B)
            inside = cell < SIZES[j]
            g = tl.load(gradients[j] + cell, mask=inside, other=0.0)
            i = start + cell
        start += SIZES[j]
    return g, i, inside


@triton.jit
def _squares(
    gradients,
    squares,
    steps,  # ()
    corrections,  # (2,)
    FIRSTS: tl.constexpr,
    SIZES: tl.constexpr,
    B: tl.constexpr,
):
    """Sum the squares of each program's numbers; count the step and correct for the zero start."""
    g, _, _ = _gradient(gradients, FIRSTS, SIZES, B)
    tl.store(squares + tl.program_id(0), tl.sum(g * g, 0))
    if tl.program_id(0) == 0:
        count = tl.load(steps) + 1.0
        tl.store(steps, count)
        first = 1.0 - tl.exp(count.to(tl.float64) * _LOG1)
        second = 1.0 - tl.exp(count.to(tl.float64) * _LOG2)
        tl.store(corrections, first.to(tl.float32))
        tl.store(corrections + 1, tl.sqrt(second).to(tl.float32))


@triton.jit
def _step(
    vector,
    gradients,
    means,
    squares_,
    corrections,  # (2,)
    rate,  # ()
    squares,  # of the gradients, one sum per program
    norms,  # ()
    max_norm,
    FIRSTS: tl.constexpr,  # programs of each gradient
    SIZES: tl.constexpr,  # of each gradient
    B: tl.constexpr,
    PROGRAMS: tl.constexpr,  # padded
):
    part = tl.arange(0, PROGRAMS)
    sums = tl.load(squares + part, mask=part < FIRSTS[len(SIZES)], other=0.0)
    norm = tl.sqrt(tl.sum(sums, 0))
    if tl.program_id(0) == 0:
        tl.store(norms, tl.load(norms) + norm)
    g, i, inside = _gradient(gradients, FIRSTS, SIZES, B)
    g /= tl.maximum(norm / max_norm, 1.0)
    m = tl.load(means + i, mask=inside, other=0.0)
    v = tl.load(squares_ + i, mask=inside, other=0.0)
    m += (1.0 - _DECAY1) * (g - m)
    v = _DECAY2 * v + (1.0 - _DECAY2) * g * g
    scale = tl.sqrt(v) / tl.load(corrections + 1) + _EPSILON
    p = tl.load(vector + i, mask=inside, other=0.0)
    p -= tl.load(rate) / tl.load(corrections) * m / scale
    tl.store(means + i, m, mask=inside)
    tl.store(squares_ + i, v, mask=inside)
    tl.store(vector + i, p, mask=inside)


def step(vector, gradients, means, squares, steps, rate, max_norm, norms=None) -> None:
    """`optimizer.step`."""
    gradients = tuple(gradient.contiguous() for gradient in gradients)
    sizes = tuple(gradient.numel() for gradient in gradients)
    firsts = (0, *accumulate(triton.cdiv(size, BLOCK) for size in sizes))
    programs = firsts[-1]
    constants = {"FIRSTS": firsts, "SIZES": sizes, "B": BLOCK}
    sums, corrections = vector.new_empty(programs), vector.new_empty(2)
    norms = vector.new_empty(()) if norms is None else norms
    with torch.cuda.device_of(vector):
        _squares[(programs,)](gradients, sums, steps, corrections, **constants)
        _step[(programs,)](
            vector,
            gradients,
            means,
            squares,
            corrections,
            rate,
            sums,
            norms,
            max_norm,
            PROGRAMS=triton.next_power_of_2(programs),
            **constants,
        )
