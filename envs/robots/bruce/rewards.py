"""What BRUCE's reward terms are made of."""

import math

import torch
from torch import Tensor


def closeness(difference: Tensor, width: float) -> Tensor:
    """(N,): 1 where nothing differs, less with the squares of (N, C)."""
    return torch.exp(-difference.square().sum(-1) / width)


def roughness(history: Tensor) -> Tensor:
    """(N,): how much the newest of (N, K, C) differs from the last, and from going on alike."""
    now, last, before = history[:, 0], history[:, 1], history[:, 2]
    return (now - last).norm(dim=-1) + (now - 2 * last + before).norm(dim=-1)


def swinging_arms(phase: Tensor, leg: Tensor) -> Tensor:
    """(N, 6) rad: where swinging arms would be, each with the leg of the other side.

    Args:
        phase: of the step, from 0 to 1, (N,).
        leg: that swings, 0 the left and 1 the right, (N,).
    """
    c = torch.cos(math.pi * (phase + leg))
    one = torch.ones_like(c)
    pitch = -0.4 * c
    right = [pitch, one, 0.3 * (1 - c)]
    left = [pitch, -one, -0.3 * (1 + c)]
    return torch.stack([*right, *left], -1)
