"""The tanh-squashed Gaussian in Triton, for CUDA.

`networks.gaussian` has the definitions. This module needs Triton, so import it only where there is
CUDA.
"""

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from ..configuration.sections import MIN_STD

ROWS = 32  # samples per program
_MIN_STD, _LOG_2 = tl.constexpr(MIN_STD), tl.constexpr(math.log(2))
_HALF_LOG_2_PI = tl.constexpr(0.5 * math.log(2 * math.pi))


@triton.jit
def softplus(x):
    return tl.maximum(x, 0.0) + tl.log(1.0 + tl.exp(-tl.abs(x)))


@triton.jit
def to_std(spread):
    """Map the second half of the actors' output to standard deviations."""
    return softplus(spread) + _MIN_STD


@triton.jit
def log_slope(u):
    """Return log(d tanh(u) / du)."""
    return 2.0 * (_LOG_2 - u - softplus(-2.0 * u))


@triton.jit
def log_density(mean, std, u):
    """Return the log-density of tanh(u)."""
    standard = (u - mean) / std
    return -0.5 * standard * standard - tl.log(std) - _HALF_LOG_2_PI - log_slope(u)


@triton.jit
def entropy_at(mean, std, u):
    """Estimate the entropy from one sample u."""
    return 0.5 + _HALF_LOG_2_PI + tl.log(std) + log_slope(u)


@triton.jit
def _sample(
    output,  # (rows, 2A)
    noise,  # (rows, A)
    action,  # (rows, A)
    log_prob,  # (rows,)
    rows,
    A: tl.constexpr,
    PADDED: tl.constexpr,
    ROWS: tl.constexpr,
):
    row, a = tl.program_id(0) * ROWS + tl.arange(0, ROWS), tl.arange(0, PADDED)
    inside = (row < rows)[:, None] & (a < A)[None, :]
    place = row[:, None] * A + a[None, :]
    mean = tl.load(output + place + row[:, None] * A, mask=inside, other=0.0)
    std = to_std(tl.load(output + place + row[:, None] * A + A, mask=inside, other=0.0))
    u = mean + std * tl.load(noise + place, mask=inside, other=0.0)
    tl.store(action + place, u, mask=inside)
    density = tl.sum(tl.where(inside, log_density(mean, std, u), 0.0), 1)
    tl.store(log_prob + row, density, mask=row < rows)


def sample(output: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """`networks.gaussian.sample`, without gradients."""
    output, noise = output.contiguous(), noise.contiguous()
    action, log_prob = torch.empty_like(noise), noise.new_empty(noise.shape[:-1])
    A, rows = noise.shape[-1], log_prob.numel()
    with torch.cuda.device_of(output):
        _sample[(triton.cdiv(rows, ROWS),)](
            output,
            noise,
            action,
            log_prob,
            rows,
            A=A,
            PADDED=triton.next_power_of_2(A),
            ROWS=ROWS,
        )
    return action, log_prob
