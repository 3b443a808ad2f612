"""CPU threads of torch, and memory: a lack of it, and giving it back."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
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


def memory_of(device: "torch.device", root: Path = Path("/")) -> int:
    """Return the bytes that are free on a GPU, or those that the CPU's programs may take.

    The latter are those of the whole machine, or what the limit of this process's container leaves.

    Args:
        device: a GPU or the CPU.
        root: folder of the file system that tells of containers.
    """
    import torch

    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    if not hasattr(os, "sysconf"):  # Windows
        return sys.maxsize
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min([whole, *_left_by_limits(root)])


def _left_by_limits(root: Path) -> Iterator[int]:
    """Yield the bytes that each Linux control group of this process may still take."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:  # another system
        lines = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            folder, names = "", ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):  # version 1
            folder = "memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        inside = PurePosixPath(path.lstrip("/"))
        for group in (inside, *inside.parents):  # limits of parents hold too
            accounts = root / "sys/fs/cgroup" / folder / group
            try:
                limit, used = (int((accounts / name).read_text()) for name in names[:2])
            except (OSError, ValueError):  # the group is not shown in a container, or has no limit
                continue
            yield max(0, limit - used + _counted(accounts / "memory.stat", names[2]))


def _counted(file: Path, name: str) -> int:
    """Return a number of a file of names and numbers, 0 without it."""
    try:
        return int(dict(line.split() for line in file.read_text().splitlines())[name])
    except (OSError, KeyError, ValueError):
        return 0


def release_memory() -> None:
    """Free the memory of learners that are no longer referenced: worlds, graphs and networks."""
    import torch

    gc.collect()  # a learner refers to itself
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
