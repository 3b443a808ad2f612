"""Building blocks of BRUCE's reward terms."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor
from torch.linalg import vector_norm


class Closeness:
    """Rewards exp(-|difference|^2 / width) for differences near zero, with a width by name."""

    def __init__(self, widths: Mapping[str, float], like: Tensor):
        self._names = tuple(widths)
        self._widths = like.new_tensor(list(widths.values()))

    def __call__(self, differences: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the rewards (N,) of differences (N, C): 1 where they are zero."""
        distances = [vector_norm(differences[name], dim=-1) for name in self._names]
        close = torch.exp(-torch.stack(distances, -1).square() / self._widths)
        return dict(zip(self._names, close.unbind(-1), strict=True))


def roughness(history: Tensor) -> Tensor:
    """Return the summed norms of the first and second difference (...,) of the newest value.

    Args:
        history: (..., 3, C), newest first.
    """
    steps = history.diff(dim=-2)
    bends = steps.diff(dim=-2)
    return vector_norm(steps[..., 0, :], dim=-1) + vector_norm(bends[..., 0, :], dim=-1)


class SwingingArms:
    """Arm joints that swing with the opposite legs."""

    def __init__(self, like: Tensor):
        self._middle = like.new_tensor([0.0, 1.0, 0.3, 0.0, -1.0, -0.3])  # rad
        self._amplitude = like.new_tensor([-0.4, 0.0, -0.3, -0.4, 0.0, -0.3])  # rad

    def __call__(self, phase: Tensor, leg: Tensor) -> Tensor:
        """Return the joints (N, 6) in rad at the `phase` (N,), 0 to 1, of a swing leg (N,)."""
        swing = torch.cos(math.pi * (phase + leg))[:, None]
        return self._middle + swing * self._amplitude
