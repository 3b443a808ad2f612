"""The last few values of something that N worlds measure."""

import torch
from torch import Tensor


class History:
    """`values` (N, length, C), the newest first.

    Args:
        like: (N, ...) whose number of worlds, dtype and device to take.
    """

    def __init__(self, like: Tensor, length: int, channels: int):
        self.values = like.new_zeros(len(like), length, channels)

    def push(self, value: Tensor) -> None:
        """Take in the newest (N, C); the oldest is forgotten."""
        self.values.copy_(torch.cat([value[:, None], self.values[:, :-1]], 1))

    def refill(self, where: Tensor, value: Tensor) -> None:
        """As if `value` (N, C) had always been, in the worlds `where` (N,) bool."""
        self.values.copy_(torch.where(where[:, None, None], value[:, None], self.values))
