"""CPU threads of torch, and a lack of memory."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

import torch

LIMITS = {  # limit, use, and how much of it is cache, in control groups of version 2 and 1
    "": ("memory.max", "memory.current", "inactive_file"),
    "memory": ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}


@contextmanager
def one_thread(device: torch.device) -> Iterator[None]:
    """Limit torch to one thread on the CPU, so that its others leave the cores to physics."""
    if device.type != "cpu":
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def shortage_of_memory(error: BaseException) -> str | None:
    """Say that memory is full, if that is why computing failed; else return None."""
    # NumPy, torch and Warp each report a lack of memory in their own way
    size = re.search(r"allocate (\d[\d.]*) ?(\w+)", str(error))
    told = isinstance(error, RuntimeError) and (size or "out of memory" in str(error))
    if not told and not isinstance(error, MemoryError):
        return None
    full = "the memory is full"
    if torch.cuda.is_available():
        free, total = (number / 2**30 for number in torch.cuda.mem_get_info())
        full = f"the GPU's memory is full ({free:.1f} of {total:.1f} GiB free)"
    more = f", and {size[1]} {size[2]} more do not fit" if size else ""
    return (
        f"{full}{more}: use fewer --worlds or --tradeoffs, or free memory that other programs hold."
    )


def memory_of(device: torch.device, root: Path = Path("/")) -> int:
    """Return the bytes that are free on a GPU, or that this process's container leaves the CPU."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    if not hasattr(os, "sysconf"):  # Windows
        return sys.maxsize
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min([total, *_left_by_limits(root)])


def _left_by_limits(root: Path) -> Iterator[int]:
    """Yield the bytes that each Linux control group of this process may still take."""
    groups = root / "proc/self/cgroup"
    for line in groups.read_text().splitlines() if groups.exists() else ():
        _, controllers, path = line.split(":", 2)
        folder = "memory" if "memory" in controllers.split(",") else ""
        limit, used, cached = LIMITS[folder]
        inside = PurePosixPath(path.lstrip("/"))
        for group in (inside, *inside.parents):  # limits of parents hold too
            accounts = root / "sys/fs/cgroup" / folder / group
            # a group may not be shown in a container, or have no limit
            with suppress(OSError, ValueError):
                left = int((accounts / limit).read_text()) - int((accounts / used).read_text())
                stat = accounts / "memory.stat"
                lines = stat.read_text().splitlines() if stat.exists() else []
                counts = dict(line.split() for line in lines)
                yield max(0, left + int(counts.get(cached, 0)))
