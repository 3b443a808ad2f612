"""Console, live progress of a command, and what happens to its errors."""

import errno
import gc
import io
import os
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import NoReturn, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ...envs.errors import MorlaxError, MorlaxWarning, words
from ...host.phases import heard_by
from ...host.torchrun import FIRST, SEVERAL
from ...host.version import __version__
from .process import INTERRUPTED, exit_when_stuck, exiting_on_signals, is_command

GRACE = 2.0  # seconds
ACTIVE_WAITS = 2000  # rounds of waiting before a thread sleeps
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # also a user's quota
LONGEST_SILENCE = 30.0  # seconds without a line on a file or pipe


def _console(quiet: bool = False, stderr: bool = False) -> Console:
    """Return a console that breaks lines between words, and only on a terminal."""
    terminal = Console(markup=False, highlight=False, emoji=False, quiet=quiet, stderr=stderr)
    terminal.soft_wrap = not terminal.is_terminal
    return terminal


console = _console(quiet=not FIRST)


def print_command(why: str, command: str) -> None:
    """Print a command, in one line so that it can be copied."""
    console.print(f"{why}: {command}", soft_wrap=True)


class Live(ExitStack):
    """Shows the phases of the work inside; on a file or pipe, after a LONGEST_SILENCE or two."""

    def __init__(self) -> None:
        super().__init__()
        text = TextColumn("{task.description}", markup=False)
        columns = BarColumn(bar_width=8), text, TimeElapsedColumn()
        hidden = not console.is_terminal
        self._moving = Progress(*columns, console=console, transient=True, disable=hidden)
        self._moving.add_task("starting", total=None)
        (self._task,) = self._moving.tasks
        self._told, self._over = False, threading.Event()

    def describe(self, name: str, share: float | None) -> str:
        return name if share is None else f"{name} {share:.0%}"

    def __enter__(self) -> Self:
        self.callback(self._over.set)
        self.enter_context(heard_by(self.show))
        self.enter_context(self._moving)
        if not console.is_terminal:
            threading.Thread(target=self._tell, daemon=True).start()
        return self

    def _tell(self) -> None:
        while not self._over.wait(LONGEST_SILENCE):
            if not self._told:
                console.print(f"   {self._task.description}")
            self._told = False

    def show(self, name: str, share: float | None = None) -> None:
        self._task.description, self._task.completed = self.describe(name, share), share or 0.0
        self._task.total = None if share is None else 1.0


def run(main: Callable[[Sequence[str]], None]) -> None:
    """Run a command; a user's mistake prints one sentence and exits with status 2."""
    _prepare()
    arguments = sys.argv[1:]
    try:
        if "--version" in arguments:
            print(f"morlax_torch {__version__}")
            return
        if any("\ud800" <= letter <= "\udfff" for letter in "".join(arguments)):
            raise MorlaxError("an argument is not valid UTF-8.")
        if "" in arguments:
            raise MorlaxError("an argument is empty: leave it out, or set its shell variable.")
        if SEVERAL:
            exit_when_stuck()
        with exiting_on_signals():
            main(arguments)
        if SEVERAL or is_command():  # tearing torch, Warp and CUDA down would take seconds
            skip_teardown()
        sys.stdout.flush()
    except SystemExit as ended:
        if SEVERAL and isinstance(ended.code, int):
            skip_teardown(ended.code)
        raise
    except MorlaxError as error:
        fail(str(error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:  # the reader closed the pipe, as `head` does
        _silence_output()
    except OSError as error:
        if error.filename is None and error.errno in FULL:
            _silence_output()
            fail("cannot print: no space left on the device that the output goes to.")
        named = (argument.rpartition("=")[2] for argument in arguments)
        if not any(name and str(error.filename).startswith(name) for name in named):
            raise  # of code that is not ours, such as a user's robot
        fail(f"cannot use {error.filename}: {error.strerror}.")
    except (AttributeError, MemoryError, RuntimeError) as error:
        from ...host.resources import shortage_of_memory  # imports torch

        if sentence := _unusable_opengl(error) or shortage_of_memory(error):
            fail(sentence)
        raise


def _prepare() -> None:
    """Set how this process prints, collects garbage, waits for threads, and shows warnings."""
    streams = sys.stdout, sys.stderr  # None where they are closed
    sys.stdout, sys.stderr = (stream or io.StringIO() for stream in streams)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a path may have letters that its encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    gc.set_threshold(1_000_000)  # looking for cycles takes a third of importing libraries
    # On a busy machine, threads that wait for each other hold cores that others need. GNU's OpenMP,
    # which torch has on Linux, reads this when torch is imported.
    set_by_user = {"OMP_WAIT_POLICY", "OMP_NUM_THREADS", "GOMP_SPINCOUNT"} & os.environ.keys()
    if not set_by_user and hasattr(os, "getloadavg") and os.getloadavg()[0] >= 1:
        os.environ["GOMP_SPINCOUNT"] = str(ACTIVE_WAITS)
    formatted = warnings.formatwarning
    warnings.formatwarning = lambda message, category, *others: (
        f"warning: {message}\n"
        if issubclass(category, MorlaxWarning)
        else formatted(message, category, *others)
    )
    usual = threading.excepthook
    # if TensorBoard's writer thread fails, its next call raises the error here
    threading.excepthook = lambda e: None if issubclass(e.exc_type, OSError) else usual(e)


def skip_teardown(status: int = 0) -> NoReturn:
    """End the process at once, where Python's teardown would do harm.

    Teardown waits for threads of libraries, and aborts those that listen to other processes.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _unusable_opengl(error: Exception) -> str | None:
    """Say that MuJoCo could not be imported because of MUJOCO_GL, if that is why `error` came."""
    chosen, frames = os.environ.get("MUJOCO_GL"), traceback.extract_tb(error.__traceback__)
    if not chosen or not any(frame.filename.endswith("mujoco/__init__.py") for frame in frames):
        return None
    return (
        f"MuJoCo cannot be imported with MUJOCO_GL={chosen}: {words(error)}. Unset MUJOCO_GL, or "
        "set it to glfw, egl or osmesa, whichever is installed."
    )


def _silence_output() -> None:
    """Drop unprinted output, which Python would report as an error on exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def fail(sentence: str) -> NoReturn:
    if not FIRST:
        time.sleep(GRACE)  # an error of all processes ends this one before, told by the first
    _console(stderr=True).print(f"error: {sentence}")
    if SEVERAL:
        skip_teardown(2)
    sys.exit(2)
