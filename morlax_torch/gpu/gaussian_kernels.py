"""The tanh-squashed Gaussian's two hot spots as one Warp kernel each, for CUDA.

One launch here replaces about a hundred of torch's, each of a microsecond's work. The torch
definitions are `networks.gaussian.sample` and `algorithms.ppo.policy_loss`.
"""

import torch
import warp as wp
from torch import Tensor

from ..config import MIN_STD as _MIN_STD

wp.set_module_options({"enable_backward": False})
MIN_STD = wp.constant(_MIN_STD)
LOG_2 = wp.constant(0.6931471805599453)
HALF_LOG_2_PI = wp.constant(0.9189385332046727)


@wp.func
def softplus(x: float):
    return wp.max(x, 0.0) + wp.log(1.0 + wp.exp(-wp.abs(x)))


@wp.func
def log_slope(u: float):
    return 2.0 * (LOG_2 - u - softplus(-2.0 * u))


@wp.func
def log_density(mean: float, std: float, u: float):
    standard = (u - mean) / std
    return -0.5 * standard * standard - wp.log(std) - HALF_LOG_2_PI - log_slope(u)


@wp.kernel
def _sample(
    output: wp.array3d(dtype=float),  # (K, G, 2A)
    noise: wp.array3d(dtype=float),  # (K, G, A)
    action: wp.array3d(dtype=float),
    log_prob: wp.array2d(dtype=float),
):
    k, i = wp.tid()
    total = float(0.0)
    size = noise.shape[2]
    for a in range(size):
        mean = output[k, i, a]
        std = softplus(output[k, i, size + a]) + MIN_STD
        u = mean + std * noise[k, i, a]
        action[k, i, a] = u
        total += log_density(mean, std, u)
    log_prob[k, i] = total


@wp.kernel
def _policy_loss(
    output: wp.array3d(dtype=float),  # (K, S, 2A)
    action: wp.array3d(dtype=float),  # (K, S, A)
    noise: wp.array3d(dtype=float),  # (K, S, A)
    old_log_prob: wp.array3d(dtype=float),  # (K, S, 1)
    advantage: wp.array3d(dtype=float),  # (K, S, 1)
    clip: float,
    mean_penalty: float,
    entropy_weight: wp.array(dtype=float),  # (1,)
    found: wp.array3d(dtype=float),  # (K, S, 5) surrogate, entropy, KL, clipped, mean^2
    slope: wp.array3d(dtype=float),  # (K, S, 2A) of the sample's loss, by output
):
    k, i = wp.tid()
    log_ratio = -old_log_prob[k, i, 0]
    entropy = float(0.0)
    squares = float(0.0)
    size = action.shape[2]
    for a in range(size):
        mean = output[k, i, a]
        std = softplus(output[k, i, size + a]) + MIN_STD
        squares += mean * mean
        log_ratio += log_density(mean, std, action[k, i, a])
        entropy += 0.5 + HALF_LOG_2_PI + wp.log(std) + log_slope(mean + std * noise[k, i, a])
    bonus = entropy_weight[0]
    ratio = wp.exp(log_ratio)
    clipped = wp.clamp(ratio, 1.0 - clip, 1.0 + clip)
    gain = advantage[k, i, 0]
    found[k, i, 0] = -wp.min(ratio * gain, clipped * gain)
    found[k, i, 1] = entropy
    found[k, i, 2] = ratio - 1.0 - log_ratio
    found[k, i, 3] = wp.where(ratio == clipped, 0.0, 1.0)
    found[k, i, 4] = squares

    by_log_ratio = wp.where(ratio * gain <= clipped * gain, -ratio * gain, 0.0)
    for a in range(size):
        mean = output[k, i, a]
        spread = output[k, i, size + a]
        std = softplus(spread) + MIN_STD
        standard = (action[k, i, a] - mean) / std
        # d log_slope(u) / du = -2 tanh(u)
        by_sample = -2.0 * wp.tanh(mean + std * noise[k, i, a])
        by_mean = by_log_ratio * standard / std - bonus * by_sample
        by_std = by_log_ratio * (standard * standard - 1.0) / std - bonus * (
            1.0 / std + by_sample * noise[k, i, a]
        )
        slope[k, i, a] = by_mean + 2.0 * mean_penalty * mean
        slope[k, i, size + a] = by_std / (1.0 + wp.exp(-spread))


def sample(output: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """`networks.gaussian.sample`."""
    action, log_prob = torch.empty_like(noise), torch.empty_like(noise[..., 0])
    arrays = [wp.from_torch(x) for x in (output, noise, action, log_prob)]
    wp.launch(_sample, dim=tuple(log_prob.shape), inputs=arrays, device=arrays[0].device)
    return action, log_prob


def policy_loss(
    output: Tensor,
    action: Tensor,
    noise: Tensor,
    old_log_prob: Tensor,
    advantage: Tensor,
    clip: float,
    mean_penalty: float,
    entropy_weight: Tensor,
) -> tuple[Tensor, Tensor]:
    """`algorithms.ppo.policy_loss`, differentiable with respect to `output` alone."""
    return _PolicyLoss.apply(
        output, action, noise, old_log_prob, advantage, clip, mean_penalty, entropy_weight
    )


class _PolicyLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx, output, action, noise, old_log_prob, advantage, clip, mean_penalty, entropy_weight
    ):
        found, slope = output.new_empty(*output.shape[:2], 5), torch.empty_like(output)
        tensors = (output, action, noise, old_log_prob, advantage, found, slope)
        *arrays, found_array, slope_array = (wp.from_torch(x.detach()) for x in tensors)
        weight = wp.from_torch(entropy_weight.reshape(1))
        wp.launch(
            _policy_loss,
            dim=tuple(found.shape[:2]),
            inputs=[*arrays, clip, mean_penalty, weight, found_array, slope_array],
            device=slope_array.device,
        )
        means = found.mean((0, 1))
        parts = means[:4]
        ctx.slope, ctx.samples = slope, found.shape[0] * found.shape[1]
        ctx.mark_non_differentiable(parts)
        return means[0] - entropy_weight * means[1] + mean_penalty * means[4], parts

    @staticmethod
    def backward(ctx, gradient, _):
        return ctx.slope * (gradient / ctx.samples), *(None,) * 7
