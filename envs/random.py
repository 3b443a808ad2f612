"""Random generators that can be saved and restored, and the draws of worlds."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

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
    if rank == 0:
        return seed
    digest = hashlib.sha256(f"{seed} {rank}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def restore_generator(generator: torch.Generator, state: Tensor) -> None:
    """Continue `generator` from a saved state.

    CPU and CUDA generators have states of different sizes. A state of the other kind becomes the
    seed, so that a run that moves between devices is still reproducible.
    """
    state = state.cpu()
    if state.numel() == generator.get_state().numel():
        generator.set_state(state)
    else:
        digest = hashlib.sha256(state.numpy().tobytes()).digest()
        generator.manual_seed(int.from_bytes(digest[:8], "little") >> 1)


@contextmanager
def drawing_from(generator: torch.Generator) -> Iterator[None]:
    """Let torch's global generator continue `generator`, and put it back afterwards."""
    if generator.device.type == "cuda":
        torch.cuda.init()  # before that, there are no generators
        usual = torch.cuda.default_generators[generator.device.index or 0]
    else:
        usual = torch.default_generator
    state = usual.get_state()
    usual.set_state(generator.get_state())
    try:
        yield
    finally:
        generator.set_state(usual.get_state())
        usual.set_state(state)
