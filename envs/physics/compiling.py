"""Compile Warp kernels in parallel; Warp itself compiles each at its first launch, one by one."""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from functools import wraps
from typing import Any
from unittest.mock import patch

import warp as wp

MOST_THREADS = 16  # each compiler takes some hundred MB of memory
# They work on what kernels have written, which is garbage while no kernel runs.
_SORTS = ("array_scan", "radix_sort_pairs", "segmented_sort_pairs")
_one_at_a_time = threading.Lock()

Variant = tuple[wp.Module, str, int | None]  # what Warp compiles at once, for a device and a block


def compile_kernels(run: Callable[[], object]) -> None:
    """Compile and load every kernel that `run` launches, without launching any.

    `run` is called once, and the arrays that it writes hold garbage afterwards. A kernel that is
    missed or cannot be compiled is left to its first launch, so results never depend on this.
    """
    needed: dict[Variant, None] = {}
    with _one_at_a_time, _no_launches(needed), suppress(Exception):
        run()
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, MOST_THREADS), "morlax-compiler")
    try:
        wait([pool.submit(module.load, device, block) for module, device, block in needed])
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C


@contextmanager
def _no_launches(needed: dict[Variant, None]) -> Iterator[None]:
    """Make launches of this thread do nothing but list in `needed` what they would load."""

    def load(module: wp.Module, device: object, block_dim: int | None = None) -> None:
        needed[module, str(device), block_dim] = None  # with nothing loaded, the launch returns

    def loop(condition: object, while_body: Callable, stream: object = None, **named: Any) -> None:
        while_body(**named)  # the condition would never change

    def branch(
        condition: object,
        on_true: Callable | None = None,
        on_false: Callable | None = None,
        stream: object = None,
        **named: Any,
    ) -> None:
        for body in (on_true, on_false):
            if body is not None:
                body(**named)

    def nothing(*_: object, **__: object) -> None:
        pass

    with ExitStack() as stack:
        for owner, name, substitute in (
            (wp.Module, "load", load),
            (wp, "capture_while", loop),
            (wp, "capture_if", branch),
            *((wp.utils, name, nothing) for name in _SORTS),
        ):
            stack.enter_context(patch.object(owner, name, _here(getattr(owner, name), substitute)))
        yield


def _here(usual: Callable, substitute: Callable) -> Callable:
    """Return a function that is `substitute` in this thread and `usual` in others."""
    thread = threading.get_ident()

    @wraps(usual)
    def either(*arguments: Any, **named: Any) -> Any:
        chosen = substitute if threading.get_ident() == thread else usual
        return chosen(*arguments, **named)

    return either
