"""Building blocks of BRUCE's reward terms."""

import math

import torch
from torch import Tensor


def closeness(difference: Tensor, width: float) -> Tensor:
    """Return exp(-|difference|^2 / width) (N,) of differences (N, C): 1 where they are zero."""
    return torch.exp(-difference.square().sum(-1) / width)


def roughness(history: Tensor) -> Tensor:
    """Return the summed norms of the first and second difference (N,) of the newest value.

    Args:
        history: (N, K, C), newest first.
    """
    now, last, before = history[:, 0], history[:, 1], history[:, 2]
    return (now - last).norm(dim=-1) + (now - 2 * last + before).norm(dim=-1)


def swinging_arms(phase: Tensor, leg: Tensor) -> Tensor:
    """Return arm joints (N, 6) in rad that swing with the opposite legs.

    Args:
        phase: (N,) elapsed share of the step, 0 to 1.
        leg: (N,) swing leg, 0 left and 1 right.
    """
    c = torch.cos(math.pi * (phase + leg))
    one = torch.ones_like(c)
    pitch = -0.4 * c
    right = [pitch, one, 0.3 * (1 - c)]
    left = [pitch, -one, -0.3 * (1 + c)]
    return torch.stack([*right, *left], -1)
