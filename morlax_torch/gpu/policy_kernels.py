"""The tanh-squashed Gaussian, and the policy loss with its gradient, in Triton, for CUDA.

`networks.gaussian` and `algorithms.ppo.policy_loss` define them. Import it only if there is CUDA.
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
def _softplus(x):
    return tl.maximum(x, 0.0) + tl.log(1.0 + tl.exp(-tl.abs(x)))


@triton.jit
def _to_std(spread):
    """Map the second half of the actors' output to standard deviations."""
    return _softplus(spread) + _MIN_STD


@triton.jit
def _log_slope(u):
    """Return log(d tanh(u) / du)."""
    return 2.0 * (_LOG_2 - u - _softplus(-2.0 * u))


@triton.jit
def _log_density(mean, std, u):
    """Return the log-density of tanh(u)."""
    standard = (u - mean) / std
    return -0.5 * standard * standard - tl.log(std) - _HALF_LOG_2_PI - _log_slope(u)


@triton.jit
def _entropy_at(mean, std, u):
    """Estimate the entropy from one sample u."""
    return 0.5 + _HALF_LOG_2_PI + tl.log(std) + _log_slope(u)


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
    cell = row[:, None] * A + a[None, :]
    mean = tl.load(output + cell + row[:, None] * A, mask=inside, other=0.0)
    std = _to_std(tl.load(output + cell + row[:, None] * A + A, mask=inside, other=0.0))
    u = mean + std * tl.load(noise + cell, mask=inside, other=0.0)
    tl.store(action + cell, u, mask=inside)
    density = tl.sum(tl.where(inside, _log_density(mean, std, u), 0.0), 1)
    tl.store(log_prob + row, density, mask=row < rows)


def sample(output: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """`networks.gaussian.sample`, without gradients."""
    output, noise = output.contiguous(), noise.contiguous()
    action, log_prob = torch.empty_like(noise), noise.new_empty(noise.shape[:-1])
    A, rows = noise.shape[-1], log_prob.numel()
    with torch.cuda.device_of(output):
        _sample[(triton.cdiv(rows, ROWS),)](
            output, noise, action, log_prob, rows, A=A, PADDED=triton.next_power_of_2(A), ROWS=ROWS
        )
    return action, log_prob


@triton.jit
def _tanh(x):
    double = tl.exp(-2.0 * tl.abs(x))
    return tl.where(x < 0, double - 1.0, 1.0 - double) / (1.0 + double)


@triton.jit
def _add(sums, part, program, programs, live, value):
    tl.store(sums + part * programs + program, tl.sum(tl.where(live, value, 0.0), 0))


@triton.jit(do_not_specialize=("S",))
def _policy(
    output,  # (K, S, 2A)
    action,  # (K, S, A)
    noise,  # (K, S, A)
    old_log_prob,  # (K, S, 1)
    advantage,  # (K, S, 1)
    action_k,  # strides
    action_s,
    old_k,
    old_s,
    advantage_k,
    advantage_s,
    entropy_weight,  # ()
    slope,  # (K, S, 2A), of the loss by the output
    sums,  # (6, programs) over each program's samples
    rows,
    S,
    clip,
    mean_penalty,
    A: tl.constexpr,
    PADDED: tl.constexpr,
    ROWS: tl.constexpr,
):
    program, programs = tl.program_id(0), tl.num_programs(0)
    row, a = program * ROWS + tl.arange(0, ROWS), tl.arange(0, PADDED)
    live = row < rows
    inside = live[:, None] & (a < A)[None, :]
    k, s = (row // S).to(tl.int64), row % S
    cell = row[:, None] * 2 * A + a[None, :]
    mean = tl.load(output + cell, mask=inside, other=0.0)
    spread = tl.load(output + cell + A, mask=inside, other=0.0)
    action_cell = (k * action_k + s * action_s)[:, None] + a[None, :]
    u = tl.load(action + action_cell, mask=inside, other=0.0)
    e = tl.load(noise + row[:, None] * A + a[None, :], mask=inside, other=0.0)
    old = tl.load(old_log_prob + k * old_k + s * old_s, mask=live, other=0.0)
    gain = tl.load(advantage + k * advantage_k + s * advantage_s, mask=live, other=0.0)
    bonus = tl.load(entropy_weight)

    std = _to_std(spread)
    log_ratio = tl.sum(tl.where(inside, _log_density(mean, std, u), 0.0), 1) - old
    ratio = tl.exp(log_ratio)
    clipped = tl.minimum(tl.maximum(ratio, 1.0 - clip), 1.0 + clip)
    drawn = mean + std * e
    entropy = tl.sum(tl.where(inside, _entropy_at(mean, std, drawn), 0.0), 1)
    _add(sums, 0, program, programs, live, -tl.minimum(ratio * gain, clipped * gain))
    _add(sums, 1, program, programs, live, entropy)
    _add(sums, 2, program, programs, live, ratio - 1.0 - log_ratio)
    _add(sums, 3, program, programs, live, tl.where(ratio == clipped, 0.0, 1.0))
    _add(sums, 4, program, programs, live, tl.sum(tl.where(inside, std, 0.0), 1) / A)
    _add(sums, 5, program, programs, live, tl.sum(mean * mean, 1))

    by_log_ratio = tl.where(ratio * gain <= clipped * gain, -ratio * gain, 0.0)[:, None]
    standard = (u - mean) / std
    by_drawn = 2.0 * bonus * _tanh(drawn)  # d log_slope(u) / du = -2 tanh(u)
    by_mean = by_log_ratio * standard / std + by_drawn + 2.0 * mean_penalty * mean
    by_std = (by_log_ratio * (standard * standard - 1.0) - bonus) / std + by_drawn * e
    tl.store(slope + cell, by_mean / rows, mask=inside)
    tl.store(slope + cell + A, by_std / (1.0 + tl.exp(-spread)) / rows, mask=inside)


@triton.jit
def _total(sums, part, programs, rows, PROGRAMS: tl.constexpr):
    i = tl.arange(0, PROGRAMS)
    return tl.sum(tl.load(sums + part * programs + i, mask=i < programs, other=0.0), 0) / rows


@triton.jit
def _policy_means(
    sums,  # (6, programs)
    entropy_weight,
    loss,  # ()
    parts,  # (5,)
    programs,
    rows,
    mean_penalty,
    PROGRAMS: tl.constexpr,  # padded
):
    for part in tl.static_range(5):
        tl.store(parts + part, _total(sums, part, programs, rows, PROGRAMS))
    total = _total(sums, 0, programs, rows, PROGRAMS)
    total -= tl.load(entropy_weight) * _total(sums, 1, programs, rows, PROGRAMS)
    total += mean_penalty * _total(sums, 5, programs, rows, PROGRAMS)
    tl.store(loss, total)


class _PolicyLoss(torch.autograd.Function):
    """`algorithms.ppo.policy_loss`, differentiable with respect to `output` alone."""

    @staticmethod
    def forward(
        ctx, output, action, noise, old_log_prob, advantage, clip, mean_penalty, entropy_weight
    ):
        K, S, A = action.shape
        programs = triton.cdiv(K * S, ROWS)
        output = output.contiguous()
        slope, sums = torch.empty_like(output), output.new_empty(6, programs)
        loss, parts = output.new_empty(()), output.new_empty(5)
        with torch.cuda.device_of(output):
            _policy[(programs,)](
                output,
                action,
                noise.contiguous(),
                old_log_prob,
                advantage,
                *action.stride()[:2],
                *old_log_prob.stride()[:2],
                *advantage.stride()[:2],
                entropy_weight,
                slope,
                sums,
                K * S,
                S,
                clip,
                mean_penalty,
                A=A,
                PADDED=triton.next_power_of_2(A),
                ROWS=ROWS,
            )
            _policy_means[(1,)](
                sums,
                entropy_weight,
                loss,
                parts,
                programs,
                K * S,
                mean_penalty,
                PROGRAMS=triton.next_power_of_2(programs),
            )
        ctx.slope = slope
        ctx.mark_non_differentiable(parts)
        ctx.set_materialize_grads(False)  # they would be zeros for `parts`
        return loss, parts

    @staticmethod
    def backward(ctx, gradient, _):
        return ctx.slope * gradient, *(None,) * 7


policy_loss = _PolicyLoss.apply
