"""Random generators that can be saved and restored."""

import hashlib

import torch
from torch import Tensor

EVALUATION_SEEDS = 2**63  # training seeds are smaller, so evaluation never repeats their draws


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
