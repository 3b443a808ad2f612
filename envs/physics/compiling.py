"""Compile Warp's kernels ahead, in several processes.

Warp itself compiles a module at the first launch of one of its kernels, one after the other.
"""

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any

import warp as wp

from ..replacing import replaced

MOST_PROCESSES = 8  # a compiler takes up to 1 GB of memory
MOST_VARIANTS = 256  # so that a byte can name one
MOST_SECONDS = 300.0  # BRUCE's largest module takes 30 s
# They work on what kernels have written, which is garbage while no kernel runs.
_SORTS = ("array_scan", "radix_sort_pairs", "segmented_sort_pairs")

Variant = tuple[wp.Module, str, int]  # Warp compiles at once: a module, a device, a block's size
_started: set[tuple[str, str]] = set()  # a process has been started for these
_running: list[int] = []
_one_at_a_time = threading.Lock()  # two threads may build worlds


def start(run: Callable[[], object]) -> None:
    """Start compiling, in background processes, the kernels of `run` that Warp's cache lacks.

    Calls `run` once without launching anything; afterwards the arrays that it writes hold garbage.
    A kernel that is missed or fails to compile is compiled at its first launch, so results never
    depend on this. Call `finish` before the first launch. Does nothing outside Linux.
    """
    if sys.platform != "linux":
        return
    with _one_at_a_time:
        missing = _missing(run)
        processes = min(len(os.sched_getaffinity(0)), MOST_PROCESSES, len(missing))
        if processes < 2:
            return
        todo, given = os.pipe()
        os.write(given, bytes(range(len(missing))))  # a byte is a variant, read by one process
        os.close(given)
        # Python warns if there are threads; without memory for a process, there are fewer of them
        with warnings.catch_warnings(action="ignore"), suppress(OSError):
            for _ in range(processes):
                process = os.fork()
                if process == 0:
                    _compile(missing, todo)
                _running.append(process)
        os.close(todo)


def finish() -> None:
    """Wait for the background processes."""
    with _one_at_a_time:
        deadline = time.monotonic() + MOST_SECONDS
        try:
            while _running and time.monotonic() < deadline:
                if not _is_running(_running[-1]):
                    _running.pop()
                else:
                    time.sleep(0.01)
        finally:
            while _running:
                process = _running.pop()
                with suppress(ProcessLookupError, ChildProcessError):
                    os.kill(process, signal.SIGKILL)
                    os.waitpid(process, 0)


def _is_running(process: int) -> bool:
    try:
        return os.waitpid(process, os.WNOHANG) == (0, 0)
    except ChildProcessError:  # someone else waited for it
        return False


def _missing(run: Callable[[], object]) -> list[Variant]:
    """Return the variants that `run` needs and nobody compiles yet, the slowest first."""
    needed: dict[Variant, None] = {}
    missing: list[Variant] = []
    with suppress(Exception), _no_launches(needed):
        run()
    with suppress(Exception):
        missing = [variant for variant in needed if _is_missing(variant)]
        missing.sort(key=lambda variant: -len(variant[0].kernels))
    return missing[:MOST_VARIANTS]


def _is_missing(variant: Variant) -> bool:
    """Return whether `variant` is neither in Warp's cache nor being compiled."""
    module, device, block = variant
    name = module.get_module_identifier(block)
    if (name, device) in _started:
        return False
    _started.add((name, device))
    file = module._get_compile_output_name(wp.get_device(device), block_dim=block)
    return not Path(str(wp.config.kernel_cache_dir), name, file).exists()


def _compile(variants: list[Variant], todo: int) -> None:
    """Compile remaining variants in this forked process, then exit.

    The parent's files are closed: a lock or a GPU must not be held after the parent's end. CUDA
    does not work in a forked process, and compiling does not need it.
    """
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        silent = os.open(os.devnull, os.O_RDWR)
        for standard in range(3):
            os.dup2(silent, standard)
        os.closerange(3, todo)
        os.closerange(todo + 1, os.sysconf("SC_OPEN_MAX"))
        while index := os.read(todo, 1):
            module, device, block = variants[index[0]]
            options = module.resolve_options(wp.config, block)
            with suppress(Exception):
                module._compile(wp.get_device(device), options=options)
    finally:
        os._exit(0)


@contextmanager
def _no_launches(needed: dict[Variant, None]) -> Iterator[None]:
    """List in `needed` the kernels that this thread would load, instead of launching them."""

    def load(module: wp.Module, device: Any, block_dim: int | None = None) -> None:
        block = module.options["block_dim"] if block_dim is None else block_dim
        needed[module, str(device), block] = None  # nothing is loaded: no launch

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

    def block_size(kernel: wp.Kernel, device: Any = None) -> tuple[int, int]:
        load(kernel.module, device or wp.get_device())
        return 256, 1  # any: nothing is launched

    def nothing(*_: object, **__: object) -> None:
        pass

    with ExitStack() as stack:
        for owner, name, substitute in (
            (wp.Module, "load", load),
            (wp, "capture_while", loop),
            (wp, "capture_if", branch),
            (wp, "get_suggested_block_size", block_size),
            *((wp.utils, name, nothing) for name in _SORTS),
        ):
            stack.enter_context(replaced(owner, name, _here(getattr(owner, name), substitute)))
        yield


def _here(usual: Callable, substitute: Callable) -> Callable:
    """Return a function that is `substitute` in this thread and `usual` in others."""
    thread = threading.get_ident()

    @wraps(usual)
    def either(*arguments: Any, **named: Any) -> Any:
        chosen = substitute if threading.get_ident() == thread else usual
        return chosen(*arguments, **named)

    return either
