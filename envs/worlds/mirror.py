"""Left and right: how a robot's numbers change when it is seen in a mirror.

The mirror flips y: a position or velocity (x, y, z) becomes (x, -y, z), and an axial vector, such
as the axis of a rotation, (-x, y, -z).
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import torch
from torch import Tensor


class Reflection(NamedTuple):
    """A mirror's effect on S features: the i-th becomes sign[i] times the order[i]-th."""

    order: Tensor  # (S,) int64
    sign: Tensor  # (S,) 1 or -1

    @classmethod
    def of(cls, order: Sequence[int], sign: Sequence[float]) -> Self:
        """Make a reflection of lists."""
        return cls(torch.tensor(order, dtype=torch.int64), torch.tensor(sign, dtype=torch.float32))

    @classmethod
    def none(cls, size: int) -> Self:
        """Make the reflection of features that a mirror does not change."""
        return cls(torch.arange(size), torch.ones(size, dtype=torch.float32))

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Join the reflections of features in a row."""
        orders, signs, start = [], [], 0
        for part in parts:
            orders.append(part.order + start)
            signs.append(part.sign)
            start += len(part.order)
        return cls(torch.cat(orders), torch.cat(signs))

    @property
    def is_none(self) -> bool:
        """Whether it changes nothing."""
        return bool((self.order == torch.arange(len(self.order))).all() and (self.sign > 0).all())

    def first(self, size: int) -> Self:
        """Return the reflection of the first features alone."""
        return self._replace(order=self.order[:size], sign=self.sign[:size])

    def __call__(self, features: Tensor) -> Tensor:
        """Reflect features (..., S)."""
        return features.index_select(-1, self.order) * self.sign

    def to(self, device: torch.device) -> Self:
        return self._replace(order=self.order.to(device), sign=self.sign.to(device))


class Mirror(NamedTuple):
    """The reflections of a robot whose left and right are alike."""

    observation: Reflection  # of the O + P features that critics see
    action: Reflection  # of the A numbers
