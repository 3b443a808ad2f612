"""CPU threads of torch, and memory: a lack of it, and giving it back."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch  # which takes seconds; commands import this module before it


@contextmanager
def one_thread(device: "torch.device") -> Iterator[None]:
    """Limit torch to one thread on the CPU, so that its others leave the cores to physics."""
    if device.type != "cpu":
        yield
        return
    import torch

    usual = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(usual)


def shortage_of_memory(error: MemoryError | RuntimeError) -> str | None:
    """Say that memory is full, if that is why computing failed; else return None."""
    # NumPy, torch and Warp each report a lack of memory in their own way
    words = ("out of memory", "allocate")
    if not isinstance(error, MemoryError) and not any(word in str(error) for word in words):
        return None
    import torch  # it, or what it computes with, is what failed

    free = "the memory is full"
    if torch.cuda.is_available():
        sizes = tuple(size / 2**30 for size in torch.cuda.mem_get_info())
        free = "the GPU's memory is full ({:.1f} of {:.1f} GiB free)".format(*sizes)
    return f"{free}: use fewer --worlds or --tradeoffs, or free memory that other programs hold."


def memory_of(device: "torch.device") -> int:
    """Return the bytes that are free on a GPU, or those of the whole machine if it tells them."""
    import torch

    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    if not hasattr(os, "sysconf"):  # Windows
        return sys.maxsize
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def release_memory() -> None:
    """Free the memory of learners that are no longer referenced: worlds, graphs and networks."""
    import torch

    gc.collect()  # a learner refers to itself
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
