"""Compile Warp's kernels ahead, in several processes.

Warp itself compiles them one by one. Threads take half as long again as processes on a GPU.
"""

import gc
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import warp as wp

MOST_PROCESSES = 8  # a compiler takes up to 1 GB of memory
MOST_SECONDS = 300.0  # BRUCE's largest module takes 30 s
# They work on what kernels have written, which is garbage while no kernel runs.
_SORTS = ("array_scan", "radix_sort_pairs", "segmented_sort_pairs")

Variant = tuple[wp.Module, str, int]  # Warp compiles at once: a module, a device, a block's size
_fork = get_context("fork" if sys.platform == "linux" else None)
_started: set[tuple[str, str]] = set()  # names of compiled modules, for a device
_running: list[tuple[Any, Any]] = []  # processes, and their counters, whose memory is else reused


def start(run: Callable[[], object]) -> None:
    """Start compiling, in background processes, the kernels of `run` that Warp's cache lacks.

    Calls `run` once without launching anything; afterwards the arrays that it writes hold garbage.
    A kernel that is missed or fails to compile is compiled at its first launch, so results never
    depend on this. Call `finish` before the first launch. Does nothing outside Linux.
    """
    if sys.platform != "linux":
        return
    needed: dict[Variant, None] = {}
    missing: list[Variant] = []
    with suppress(Exception), _no_launches(needed):
        run()
    with suppress(Exception):
        missing = [variant for variant in needed if _is_missing(variant)]
    missing.sort(key=lambda each: -len(each[0].kernels))  # the slowest first
    taken = _fork.Value("i", 0)
    # Python warns if there are threads; without memory for a process, there are fewer of them, and
    # a daemonic process may have none
    with warnings.catch_warnings(action="ignore"), suppress(OSError, AssertionError):
        for _ in range(min(len(os.sched_getaffinity(0)), MOST_PROCESSES, len(missing))):
            process = _fork.Process(target=_compile, args=(missing, taken), daemon=True)
            process.start()
            _running.append((process, taken))


def finish() -> None:
    """Wait for the background processes, but no longer than `MOST_SECONDS`."""
    try:
        end = time.monotonic() + MOST_SECONDS
        for process, _ in _running:
            # `join` would ignore a time limit: the process has closed the file that it waits for
            while process.is_alive() and time.monotonic() < end:
                time.sleep(0.005)
    finally:
        while _running:
            process, _ = _running.pop()
            process.kill()
            process.join()


def _is_missing(variant: Variant) -> bool:
    """Return whether a variant is neither in Warp's cache nor being compiled."""
    module, device, block = variant
    name = module.get_module_identifier(block)  # which several sizes of blocks may share
    if (name, device) in _started:
        return False
    _started.add((name, device))
    file = module._get_compile_output_name(wp.get_device(device), block_dim=block)
    return not Path(str(wp.config.kernel_cache_dir), name, file).exists()


def _compile(variants: list[Variant], taken: Any) -> None:
    """Compile variants that no other process has taken, without CUDA, and end this process."""
    gc.disable()  # garbage of the parent may wait for threads that this process does not have
    silent = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(silent, standard)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # no lock or GPU is held after the parent's end
    while True:
        with taken.get_lock():
            index, taken.value = taken.value, taken.value + 1
        if index >= len(variants):
            os._exit(0)
        module, device, block = variants[index]
        with suppress(Exception):
            module._compile(wp.get_device(device), options=module.resolve_options(wp.config, block))


@contextmanager
def _no_launches(needed: dict[Variant, None]) -> Iterator[None]:
    """Add to `needed` the kernels that this thread would load, instead of launching them."""
    thread = threading.get_ident()  # others may launch kernels meanwhile

    def load(module: wp.Module, device: Any, block_dim: int | None = None) -> None:
        block = module.options["block_dim"] if block_dim is None else block_dim
        needed[module, str(device), block] = None  # nothing is loaded: no launch

    def loop(condition: object, while_body: Callable, stream: object = None, **named: Any) -> None:
        while_body(**named)  # once: the condition would never change

    def branch(condition: object, on_true: Any = None, on_false: Any = None, **named: Any) -> None:
        for body in filter(None, (on_true, on_false)):
            body(**named)

    def block_size(kernel: wp.Kernel, device: Any = None) -> tuple[int, int]:
        load(kernel.module, device or wp.get_device())
        return 256, 1  # any: nothing is launched

    def here(usual: Callable, substitute: Callable) -> Callable:
        def either(*arguments: Any, **named: Any) -> Any:
            chosen = substitute if threading.get_ident() == thread else usual
            return chosen(*arguments, **named)

        return either

    with ExitStack() as stack:  # Warp has no hook for a rehearsal
        for owner, name, substitute in (
            (wp.Module, "load", load),
            (wp, "capture_while", loop),
            (wp, "capture_if", branch),
            (wp, "get_suggested_block_size", block_size),
            *((wp.utils, name, lambda *_, **__: None) for name in _SORTS),
        ):
            stack.enter_context(patch.object(owner, name, here(getattr(owner, name), substitute)))
        yield
