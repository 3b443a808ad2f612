"""Random generators that can be saved and restored."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

EVALUATION_SEEDS = 2**63  # training seeds are smaller, so evaluation never repeats their draws


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
