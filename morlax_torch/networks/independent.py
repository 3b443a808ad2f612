"""Separate networks, which share no parameters."""

import torch
from torch import Tensor, nn

from .family import on_simplex
from .generated import Generated


class InOrder(Generated):
    """R networks that share no parameters; the k-th of R trade-offs gets the k-th.

    Args:
        target: the module that all networks start as; it is copied, not changed.
        number: R.
    """

    def __init__(self, target: nn.Module, number: int):
        super().__init__(target)
        start = torch.cat([p.detach().flatten() for p in target.parameters()])
        self.rows = nn.Parameter(start.repeat(number, 1))  # (R, P)

    def flat(self, tradeoffs: Tensor) -> Tensor:
        assert len(tradeoffs) == len(self.rows), "one trade-off per network"
        return self.rows


class Independent(InOrder):
    """R networks that share no parameters; a trade-off w gets the one it values most.

    That is the network r with the largest w . keys[r] + offsets[r]. With points a of the simplex as
    keys and -|a|²/2 as offsets, it is the nearest one; with returns as keys and no offsets, the one
    with the largest weighted return.

    Args:
        target: the module that all networks start as; it is copied, not changed.
        keys: points of the simplex (R, m), so that the nearest network is chosen at first.
    """

    keys: Tensor
    offsets: Tensor

    def __init__(self, target: nn.Module, keys: Tensor):
        super().__init__(target, len(keys))
        self.register_buffer("keys", keys.clone())  # (R, m)
        self.register_buffer("offsets", keys.square().sum(-1) / -2)  # (R,)

    def flat(self, tradeoffs: Tensor) -> Tensor:
        return self.rows.index_select(0, self.chosen(tradeoffs))

    def chosen(self, tradeoffs: Tensor) -> Tensor:
        """Return the index (...) of the network of each trade-off (..., m)."""
        # no matrix product, which GPUs round to TF32: keys may differ by less than that
        products = on_simplex(tradeoffs)[..., None, :] * self.keys
        return (products.sum(-1) + self.offsets).argmax(-1)
