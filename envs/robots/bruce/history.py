"""Short histories of measured quantities in N worlds."""

import torch
from torch import Tensor


class History:
    """The latest `values` (N, length, C), newest first.

    Args:
        like: (N, ...) tensor that sets the number of worlds, dtype and device.
        length: number of values to keep.
        channels: C.
    """

    def __init__(self, like: Tensor, length: int, channels: int):
        self.values = like.new_zeros(len(like), length, channels)

    def push(self, value: Tensor) -> None:
        """Add the newest value (N, C) and drop the oldest."""
        self.values.copy_(torch.cat([value[:, None], self.values[:, :-1]], 1))

    def refill(self, where: Tensor, value: Tensor) -> None:
        """Fill the whole history with `value` (N, C) in the worlds `where` (N,) bool."""
        self.values.copy_(torch.where(where[:, None, None], value[:, None], self.values))
