"""A Gaussian squashed by tanh, the distribution of actions."""

import math
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import softplus

from ..configuration.sections import MIN_STD


class TanhNormal:
    """A Gaussian squashed by tanh. Its samples stay unsquashed: `tanh` makes them actions.

    Args:
        output: of the actors, (..., 2A): means, then standard deviations before the softplus.
    """

    def __init__(self, output: Tensor):
        self.output = output

    @cached_property
    def mean(self) -> Tensor:
        """(..., A)"""
        return self.output.chunk(2, dim=-1)[0]

    @cached_property
    def std(self) -> Tensor:
        """(..., A)"""
        return softplus(self.output.chunk(2, dim=-1)[1]) + MIN_STD

    @property
    def mode(self) -> Tensor:
        """The deterministic action (..., A) in (-1, 1): tanh of the mean."""
        return self.mean.tanh()

    def log_prob(self, action: Tensor) -> Tensor:
        """Return the log-density (...) of tanh(action), for unsquashed actions (..., A)."""
        standard = (action - self.mean) / self.std
        gaussian = -0.5 * standard.square() - self.std.log() - 0.5 * math.log(2 * math.pi)
        return (gaussian - _log_slope(action)).sum(-1)

    def entropy(self, noise: Tensor) -> Tensor:
        """Estimate the entropy (...) from one sample: the Gaussian's plus the tanh's log-slope."""
        gaussian = 0.5 + 0.5 * math.log(2 * math.pi) + self.std.log()
        return (gaussian + _log_slope(self.mean + self.std * noise)).sum(-1)


def spread_of(std: float) -> float:
    """Return the output of actors that `TanhNormal` turns into a standard deviation."""
    return math.log(math.expm1(std - MIN_STD))


def limited(output: Tensor, max_std: float) -> Tensor:
    """Return the actors' output (..., 2A) with standard deviations smoothly below `max_std`."""
    mean, spread = output.chunk(2, dim=-1)
    most = spread_of(max_std)
    return torch.cat([mean, most - softplus(most - spread)], -1)


def sample(output: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Return actions before the tanh (K, G, A), with their log-probabilities (K, G).

    The actors' output is (K, G, 2A), the standard normal noise (K, G, A).
    """
    policy = TanhNormal(output)
    action = policy.mean + policy.std * noise
    return action, policy.log_prob(action)


def _log_slope(action: Tensor) -> Tensor:
    """Return log(d tanh(u) / du), in a form that does not overflow."""
    return 2 * (math.log(2) - action - softplus(-2 * action))
