"""The compute device that worlds and networks live on, and the choice of kernels on it."""

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

import torch

from .errors import MorlaxError

P = ParamSpec("P")
R = TypeVar("R")


def resolve_device(device: str | torch.device | None) -> torch.device:
    """Return the requested device; None selects CUDA if there is a GPU, else the CPU.

    Raises:
        MorlaxError: the name is not a CPU or CUDA device, or there is no such GPU.
    """
    if device is None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        found = torch.device(device)
    except RuntimeError:
        raise MorlaxError(f"{device!r} is not a device: use 'cuda', 'cuda:1' or 'cpu'.") from None
    if found.type not in ("cpu", "cuda"):
        raise MorlaxError(f"device {found} is not supported: use 'cuda' or 'cpu'.")
    if found.type == "cuda":
        if not torch.cuda.is_available():
            raise MorlaxError("no CUDA device was found: use --device cpu, or check the driver.")
        found = torch.device("cuda", found.index or 0)
        if found.index >= torch.cuda.device_count():
            raise MorlaxError(
                f"{found} does not exist: this machine has {torch.cuda.device_count()} GPUs."
            )
    return found


def kernel(twin: str, suits: Callable[..., bool]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a GPU kernel replace the torch definition that is decorated, where it suits.

    Args:
        twin: "package.module.function", of the same parameters; imported when first used.
        suits: tells from the positional arguments whether the twin runs.
    """
    module, _, name = twin.rpartition(".")

    def replaceable(definition: Callable[P, R]) -> Callable[P, R]:
        @wraps(definition)
        def either(*args: P.args, **kwargs: P.kwargs) -> R:
            run = getattr(import_module(module), name) if suits(*args) else definition
            return run(*args, **kwargs)

        return either

    return replaceable
