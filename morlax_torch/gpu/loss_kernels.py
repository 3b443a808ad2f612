"""The policy loss with its gradient, in Triton, for CUDA.

`algorithms.ppo.policy_loss` is the definition. This module needs Triton, so import it only where
there is CUDA.
"""

import torch
import triton
import triton.language as tl

from .gaussian_kernels import ROWS, entropy_at, log_density, to_std


@triton.jit
def _tanh(x):
    double = tl.exp(-2.0 * tl.abs(x))
    return tl.where(x < 0, double - 1.0, 1.0 - double) / (1.0 + double)


@triton.jit
def _add(found, part, program, programs, live, value):
    tl.store(found + part * programs + program, tl.sum(tl.where(live, value, 0.0), 0))


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
    found,  # (6, programs), the sums over each program's samples
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
    place = row[:, None] * 2 * A + a[None, :]
    mean = tl.load(output + place, mask=inside, other=0.0)
    spread = tl.load(output + place + A, mask=inside, other=0.0)
    own = (k * action_k + s * action_s)[:, None] + a[None, :]
    u = tl.load(action + own, mask=inside, other=0.0)
    e = tl.load(noise + row[:, None] * A + a[None, :], mask=inside, other=0.0)
    old = tl.load(old_log_prob + k * old_k + s * old_s, mask=live, other=0.0)
    gain = tl.load(advantage + k * advantage_k + s * advantage_s, mask=live, other=0.0)
    bonus = tl.load(entropy_weight)

    std = to_std(spread)
    log_ratio = tl.sum(tl.where(inside, log_density(mean, std, u), 0.0), 1) - old
    ratio = tl.exp(log_ratio)
    clipped = tl.minimum(tl.maximum(ratio, 1.0 - clip), 1.0 + clip)
    drawn = mean + std * e
    entropy = tl.sum(tl.where(inside, entropy_at(mean, std, drawn), 0.0), 1)
    _add(found, 0, program, programs, live, -tl.minimum(ratio * gain, clipped * gain))
    _add(found, 1, program, programs, live, entropy)
    _add(found, 2, program, programs, live, ratio - 1.0 - log_ratio)
    _add(found, 3, program, programs, live, tl.where(ratio == clipped, 0.0, 1.0))
    _add(found, 4, program, programs, live, tl.sum(tl.where(inside, std, 0.0), 1) / A)
    _add(found, 5, program, programs, live, tl.sum(mean * mean, 1))

    by_log_ratio = tl.where(ratio * gain <= clipped * gain, -ratio * gain, 0.0)[:, None]
    standard = (u - mean) / std
    by_drawn = 2.0 * bonus * _tanh(drawn)  # d log_slope(u) / du = -2 tanh(u)
    by_mean = by_log_ratio * standard / std + by_drawn + 2.0 * mean_penalty * mean
    by_std = (by_log_ratio * (standard * standard - 1.0) - bonus) / std + by_drawn * e
    tl.store(slope + place, by_mean / rows, mask=inside)
    tl.store(slope + place + A, by_std / (1.0 + tl.exp(-spread)) / rows, mask=inside)


@triton.jit
def _total(found, part, programs, rows, PROGRAMS: tl.constexpr):
    i = tl.arange(0, PROGRAMS)
    return tl.sum(tl.load(found + part * programs + i, mask=i < programs, other=0.0), 0) / rows


@triton.jit
def _policy_means(
    found,  # (6, programs)
    entropy_weight,
    loss,  # ()
    parts,  # (5,)
    programs,
    rows,
    mean_penalty,
    PROGRAMS: tl.constexpr,  # padded
):
    for part in tl.static_range(5):
        tl.store(parts + part, _total(found, part, programs, rows, PROGRAMS))
    total = _total(found, 0, programs, rows, PROGRAMS)
    total -= tl.load(entropy_weight) * _total(found, 1, programs, rows, PROGRAMS)
    total += mean_penalty * _total(found, 5, programs, rows, PROGRAMS)
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
        slope, found = torch.empty_like(output), output.new_empty(6, programs)
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
                found,
                K * S,
                S,
                clip,
                mean_penalty,
                A=A,
                PADDED=triton.next_power_of_2(A),
                ROWS=ROWS,
            )
            _policy_means[(1,)](
                found,
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
