"""Ways to run mjlab's own terms: with constants that stay, and with draws that worlds share."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode


class SharedDraws(TorchDispatchMode):
    """Lets worlds of the same episode draw alike, wherever N rows are drawn at once.

    Args:
        episodes: (N,) index of each world's episode.
    """

    def __init__(self, episodes: Tensor):
        super().__init__()
        self.number, self.source = len(episodes), episodes % len(episodes)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        drawn = func(*args, **(kwargs or {}))
        if torch.Tag.nondeterministic_seeded not in func.tags or drawn.shape[:1] != (self.number,):
            return drawn
        shared = drawn[self.source]
        return drawn.copy_(shared) if func._schema.is_mutable else shared


class Constants(TorchFunctionMode):
    """Keeps the tensors that mjlab makes of numbers, since a recording cannot copy these to a GPU.

    They are those of `torch.tensor`, and lists of indices.
    """

    def __init__(self) -> None:
        super().__init__()
        self._kept: dict[tuple[Any, ...], Tensor] = {}

    def __torch_function__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        if func is torch.tensor:
            return self._keep((repr(args), repr(kwargs)), lambda: func(*args, **kwargs)).clone()
        if func in (Tensor.__getitem__, Tensor.__setitem__):
            of, index, *value = args
            parts = index if isinstance(index, tuple) else (index,)
            args = (of, tuple(self._there(part, of.device) for part in parts), *value)
            if value and isinstance(value[0], (bool, int, float)):
                kind = {"dtype": of.dtype, "device": of.device}
                given = self._keep((*value, *kind.values()), lambda: torch.tensor(*value, **kind))
                args = (*args[:2], given)
        return func(*args, **kwargs)

    def _there(self, index: Any, device: torch.device) -> Any:
        if not isinstance(index, list):
            return index
        return self._keep((*index, device), lambda: torch.tensor(index, device=device))

    def _keep(self, key: tuple[Any, ...], make: Callable[[], Tensor]) -> Tensor:
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]
