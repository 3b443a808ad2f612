"""Short histories of several quantities in N worlds."""

from collections.abc import Mapping

import torch
from torch import Tensor


class Histories:
    """The latest values (N, K, C) of several quantities, newest first.

    All are views of one buffer, so that one operation pushes or refills them.

    `sizes` are the number of values to keep and of channels, (K, C), by name.
    """

    def __init__(self, like: Tensor, sizes: Mapping[str, tuple[int, int]]):
        widths = [length * channels for length, channels in sizes.values()]
        self._all = like.new_zeros(len(like), sum(widths))
        parts = zip(sizes.items(), self._all.split(widths, -1), strict=True)
        self._values = {name: part.unflatten(-1, size) for (name, size), part in parts}

    def __getitem__(self, name: str) -> Tensor:
        return self._values[name]

    def state(self) -> dict[str, Tensor]:
        """Return every history, by its key in saved states."""
        return {f"_{name}": values for name, values in self._values.items()}

    def push(self, newest: Mapping[str, Tensor]) -> None:
        """Add the newest value (N, C) of each history and drop the oldest."""
        pieces = []
        for name, values in self._values.items():
            pieces += [newest[name], values[:, :-1].flatten(1)]
        self._all.copy_(torch.cat(pieces, -1))

    def refill(self, where: Tensor, value: Mapping[str, Tensor]) -> None:
        """Fill each history with its value (N, C) in the worlds `where` (N,) bool."""
        pieces = [value[name] for name, old in self._values.items() for _ in range(old.shape[1])]
        torch.where(where[:, None], torch.cat(pieces, -1), self._all, out=self._all)
