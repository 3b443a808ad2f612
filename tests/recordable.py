"""Modes of torch that fail at what a recorded graph cannot hold."""

import numpy as np
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode


class NoSync(TorchDispatchMode):
    """Fails at operations that wait for a GPU, which a recording cannot hold."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = str(func)
        assert not any(part in name for part in ("nonzero", "_local_scalar_dense", "masked_select"))
        if "index" in name and isinstance(args[1], (list, tuple)):
            assert not any(isinstance(x, torch.Tensor) and x.dtype == torch.bool for x in args[1])
        return func(*args, **(kwargs or {}))


class NoCopies(TorchFunctionMode):
    """Fails where numbers become tensors, which a recording cannot copy to a GPU."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        assert func is not torch.tensor
        if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            assert not any(isinstance(part, (list, np.ndarray)) for part in index)
        return func(*args, **(kwargs or {}))
