"""The process of a command: how it was started, when, and the signals that end it."""

import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import cache_from_source, find_spec
from itertools import pairwise
from typing import Any

BEGAN = time.perf_counter()  # almost when the process began: the package imports this module first
INTERRUPTED = 130  # the exit status of a program that Ctrl-C ended
STUCK = 5.0  # seconds in which a process that is not stuck notices a signal
SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]

_noticed = threading.Event()  # set when Python has run one of the signal handlers below


def _is_module() -> bool:
    modules = (word for option, word in pairwise(sys.orig_argv) if option == "-m")
    return any(module.split(".")[0] == "morlax_torch" for module in modules)


def is_command() -> bool:
    """Return whether this process was started as `morlax` or `python -m morlax_torch`."""
    scripts = {os.path.basename(word) for word in sys.orig_argv[:2]}
    return _is_module() or bool(scripts & {"morlax", "morlax.exe"})


def program(name: str) -> str:
    """Return how to start the command `name`: through `python -m` if this one was started so."""
    return f"python -m morlax_torch {name}" if _is_module() else f"morlax {name}"


def typed(command: str, *words: object) -> str:
    """Return a command line to copy, its words quoted where a shell needs it."""
    return f"{program(command)} {shlex.join(map(str, words))}"


def end_at_once_on_ctrl_c() -> None:
    """Let Ctrl-C end a command with one word while nothing is to be cleaned up: as it imports.

    An exception would come out of an import as a traceback, or be lost in one.
    """

    if is_command() and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: Any = None) -> None:
    if number == signal.SIGINT:
        os.write(2, b"interrupted\n")
    os._exit(128 + number)


def keep_bytecode() -> None:
    """Let a command keep compiled Python in the user's cache where Python would keep none of it.

    Many container images forbid it, or have read-only packages without it: importing torch and
    MuJoCo Warp then takes two seconds longer, every time.
    """
    if not is_command() or sys.pycache_prefix:
        return
    torch = find_spec("torch")
    kept = torch and torch.origin and os.path.exists(cache_from_source(torch.origin))
    if sys.dont_write_bytecode or not kept:
        cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        sys.pycache_prefix = os.path.join(cache, "morlax", "bytecode")
        sys.dont_write_bytecode = False


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """Yield a list that gets the first of SIGNALS that comes; a second one acts as usual."""
    received: list[int] = []

    def receive(number: int, frame: Any) -> None:
        received.append(number)
        for which, handler in usual.items():
            signal.signal(which, handler)

    with _handling(receive) as usual:
        yield received


@contextmanager
def exiting_on_signals() -> Iterator[None]:
    """Raise an exception for each of SIGNALS, so that `finally` removes temporary files."""
    endings: list[BaseException] = []

    def receive(number: int, frame: Any) -> None:
        # torch's C++ code aborts at an exception that comes while it is imported
        if getattr(getattr(sys.modules.get("torch"), "__spec__", None), "_initializing", False):
            _end(number)
        ending = KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
        endings.append(ending)
        raise ending

    with _handling(receive):
        try:
            yield
        except Exception:  # what TorchScript makes of an exception that is raised within it
            if endings:
                raise endings[-1] from None
            raise


@contextmanager
def _handling(handle: Callable[[int, Any], None]) -> Iterator[dict[signal.Signals, Any]]:
    def receive(number: int, frame: Any) -> None:
        _noticed.set()
        handle(number, frame)

    # nohup ignores SIGHUP, and shells ignore SIGINT for jobs in the background
    heard = [which for which in SIGNALS if signal.getsignal(which) != signal.SIG_IGN]
    usual = {which: signal.signal(which, receive) for which in heard}
    try:
        yield usual
    finally:
        for which, handler in usual.items():
            signal.signal(which, handler)


def exit_when_stuck() -> None:
    """Exit from now on at a SIGTERM that Python does not notice within STUCK seconds.

    Python runs signal handlers between its own instructions, but a process that waits for one that
    has ended, in NCCL or in a rendezvous, does not come back to them.
    """
    received, notice = os.pipe()
    os.set_blocking(notice, False)
    signal.set_wakeup_fd(notice)

    def watch() -> None:
        while number := os.read(received, 1):
            if number[0] == signal.SIGTERM and not _noticed.wait(STUCK):
                os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
