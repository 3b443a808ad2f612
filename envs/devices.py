"""Compute devices, and random generators on them that can be saved, restored and shared."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from .errors import MorlaxError


def resolve_device(device: str | torch.device | None) -> torch.device:
    """Return the requested device; None selects CUDA if there is a GPU, else the CPU."""
    if device is None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(device)
    except (RuntimeError, TypeError):
        raise MorlaxError(f"{device!r} is not a device: use 'cuda', 'cuda:1' or 'cpu'.") from None
    if device.type not in ("cpu", "cuda"):
        raise MorlaxError(f"device {device} is not supported: use 'cuda' or 'cpu'.")
    if device.type == "cuda":
        if not torch.cuda.is_available():
            raise MorlaxError("no CUDA device was found: use --device cpu, or check the driver.")
        device, number = torch.device("cuda", device.index or 0), torch.cuda.device_count()
        if device.index >= number:
            raise MorlaxError(f"{device} does not exist: this machine has {number} GPUs.")
    return device


EVALUATION_SEEDS = 2**63  # training seeds are smaller, so evaluation never repeats their draws


class Draws:
    """Draws random numbers for N worlds into tensors (N, ...), in place.

    After `share`, the worlds of one episode get the same numbers, so that differences between their
    policies are not differences between their draws.
    """

    def __init__(self, generator: torch.Generator, num_worlds: int):
        self.generator, self.number = generator, num_worlds  # of different rows
        self._episodes: Tensor | None = None

    def share(self, episodes: Tensor, number: int) -> None:
        """Draw `number` rows from now on, and give each world that of its `episodes` (N,)."""
        self.number, self._episodes = number, episodes.to(self.generator.device)

    def normal_(self, out: Tensor) -> Tensor:
        return self._fill(out, lambda rows: rows.normal_(generator=self.generator))

    def uniform_(self, out: Tensor, low: float = 0.0, high: float = 1.0) -> Tensor:
        return self._fill(out, lambda rows: rows.uniform_(low, high, generator=self.generator))

    def integers_(self, out: Tensor, low: int, high: int) -> Tensor:
        """Draw integers from `low` to `high - 1`."""
        return self._fill(out, lambda rows: rows.random_(low, high, generator=self.generator))

    def of_worlds(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows (N, ...) of the worlds, given at least `number` rows."""
        return rows if self._episodes is None else rows[self._episodes.cpu().numpy()]

    def _fill(self, out: Tensor, draw: Callable[[Tensor], Tensor]) -> Tensor:
        if self._episodes is None:
            return draw(out)
        return out.copy_(draw(out.new_empty(self.number, *out.shape[1:]))[self._episodes])


def seed_of(seed: int, rank: int) -> int:
    """Return the seed of the process `rank` of a run with `seed`; its first process has that."""
    return _hashed(f"{seed} {rank}".encode()) if rank else seed


def restore_generator(generator: torch.Generator, state: Tensor) -> None:
    """Continue `generator` from a saved state."""
    # CPU and CUDA generators have states of different sizes. A state of the other kind becomes the
    # seed, so that a run that moves between devices is still reproducible.
    state = state.cpu()
    if state.numel() == generator.get_state().numel():
        generator.set_state(state)
    else:
        generator.manual_seed(_hashed(state.numpy().tobytes()))


def _hashed(data: bytes) -> int:
    return int.from_bytes(hashlib.sha256(data).digest()[:8], "little") >> 1


def global_generator(device: torch.device) -> torch.Generator:
    """Return the generator of a device that torch draws from unless another one is named."""
    if device.type == "cpu":
        return torch.default_generator
    torch.cuda.init()  # creates the generators
    return torch.cuda.default_generators[device.index or 0]


@contextmanager
def drawing_from(generator: torch.Generator) -> Iterator[None]:
    """Let torch's global generator continue `generator`, and put it back afterwards."""
    usual = global_generator(generator.device)
    if usual is generator:
        yield
        return
    state = usual.get_state()
    usual.set_state(generator.get_state())
    try:
        yield
    finally:
        generator.set_state(usual.get_state())
        usual.set_state(state)
