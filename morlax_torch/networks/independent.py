"""Separate networks for a fixed set of trade-offs."""

import torch
from torch import Tensor, nn

from .family import on_simplex
from .generated import Generated


class Independent(Generated):
    """R networks that share no parameters; a trade-off gets the nearest one's.

    Each network has a key, a point of the simplex, and a trade-off w gets the network whose key a
    has the largest w . a - |a|²/2, that is, the smallest distance |w - a|.

    Args:
        target: the module that all networks start as; it is copied, not changed.
        keys: (R, m).
    """

    keys: Tensor

    def __init__(self, target: nn.Module, keys: Tensor):
        super().__init__(target)
        start = torch.cat([p.detach().flatten() for p in target.parameters()])
        self.rows = nn.Parameter(start.repeat(len(keys), 1))  # (R, P)
        self.register_buffer("keys", keys.clone())

    def flat(self, tradeoffs: Tensor) -> Tensor:
        return self.rows.index_select(0, self.nearest(tradeoffs))

    def nearest(self, tradeoffs: Tensor) -> Tensor:
        """Return which network each of the trade-offs (K, m) gets, (K,)."""
        lengths = self.keys.square().sum(-1)
        return (on_simplex(tradeoffs) @ self.keys.mT - lengths / 2).argmax(-1)
