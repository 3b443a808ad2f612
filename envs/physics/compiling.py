"""Compile Warp's kernels ahead, in several threads: Warp itself compiles them one by one."""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from typing import Any
from unittest.mock import patch

import warp as wp

MOST_THREADS = 8  # a compiler takes up to 1 GB of memory
# They work on what kernels have written, which is garbage while no kernel runs.
_SORTS = ("array_scan", "radix_sort_pairs", "segmented_sort_pairs")

Variant = tuple[wp.Module, str, int]  # Warp compiles at once: a module, a device, a block's size
_started: set[Variant] = set()
_running: list[ThreadPoolExecutor] = []


def start(run: Callable[[], object]) -> None:
    """Start compiling and loading, in background threads, the kernels of `run`.

    Calls `run` once without launching anything; afterwards the arrays that it writes hold garbage.
    A kernel that is missed or fails to compile is compiled at its first launch, so results never
    depend on this. Call `finish` before the first launch.
    """
    needed: set[Variant] = set()
    with suppress(Exception), _no_launches(needed):
        run()
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, MOST_THREADS))
    _running.append(pool)
    # as wp.force_load does, which takes one size of blocks; the slowest first
    for variant in sorted(needed - _started, key=lambda each: -len(each[0].kernels)):
        module, device, block = variant
        pool.submit(module.load, device, block)
        _started.add(variant)


def finish() -> None:
    """Wait for the background threads."""
    while _running:
        pool = _running.pop()
        try:
            pool.shutdown()
        finally:  # Ctrl-C waits only for what compiles now
            pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def _no_launches(needed: set[Variant]) -> Iterator[None]:
    """Add to `needed` the kernels that this thread would load, instead of launching them."""
    thread = threading.get_ident()  # others may launch kernels meanwhile

    def load(module: wp.Module, device: Any, block_dim: int | None = None) -> None:
        block = module.options["block_dim"] if block_dim is None else block_dim
        needed.add((module, str(device), block))  # nothing is loaded: no launch

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

    with ExitStack() as stack:
        for owner, name, substitute in (
            (wp.Module, "load", load),
            (wp, "capture_while", loop),
            (wp, "capture_if", branch),
            (wp, "get_suggested_block_size", block_size),
            *((wp.utils, name, lambda *_, **__: None) for name in _SORTS),
        ):
            stack.enter_context(patch.object(owner, name, here(getattr(owner, name), substitute)))
        yield
