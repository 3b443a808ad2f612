"""Start of a command: when and how it was typed, its first line, garbage collection, Ctrl-C."""

import gc
import io
import os
import signal
import sys
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import NoReturn

from ...host.torchrun import FIRST

INTERRUPTED = 130  # the exit status of a program that Ctrl-C ended
ACTIVE_WAITS = 2000  # rounds of waiting before a thread sleeps
LOOKS = 5  # whether others run
UTF8 = "PYTHONUTF8"  # environment variable
START = 19  # position of a process's start in /proc/PID/stat, after its name in brackets


def command_words() -> list[str] | None:
    """Return the command that this process was started as, such as ["train", "--env", "ant"].

    None: it was not started as a command of morlax_torch.
    """
    for position, (option, module) in enumerate(pairwise(sys.orig_argv)):
        if option == "-m" and module.split(".")[0] == "morlax_torch":
            return [*module.split(".")[1:], *sys.orig_argv[position + 2 :]]
    for position, word in enumerate(sys.orig_argv[:2]):
        name, ending = os.path.splitext(os.path.basename(word))
        if ending in ("", ".exe") and name == "morlax":
            return sys.orig_argv[position + 1 :]
    return None


def program(name: str) -> str:
    """Return how to start the command `name`: through `python -m` if this one was started so."""
    modules = (word for option, word in pairwise(sys.orig_argv) if option == "-m")
    if any(module.split(".")[0] == "morlax_torch" for module in modules):
        return f"python -m morlax_torch {name}"
    return f"morlax {name}"


def use_utf8() -> None:
    """Start this command anew in Python's UTF-8 mode, unless names of files are UTF-8 already.

    In an ASCII locale, Python could neither decode other names nor write them into files. On an
    output that is not UTF-8, such characters are escaped.
    """
    is_tried = os.environ.get(UTF8) == "1" or command_words() is None
    if sys.getfilesystemencoding() != "utf-8" and not is_tried:
        os.execve(sys.executable, sys.orig_argv, {**os.environ, UTF8: "1"})
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() != "utf-8":
            stream.reconfigure(errors="backslashreplace")


def collect_garbage_rarely() -> None:
    """Make Python look for reference cycles less often, which takes a third of importing torch."""
    gc.set_threshold(100_000)


def share_busy_cores() -> None:
    """If other programs run, make torch's threads sleep soon when they wait for each other.

    By default, a waiting thread holds its core for milliseconds, which the thread that it waits for
    may need. On an idle machine that is faster. GNU's OpenMP, which torch has on Linux, reads the
    variable when torch is imported.
    """
    told = {"OMP_WAIT_POLICY", "OMP_NUM_THREADS", "GOMP_SPINCOUNT"} & os.environ.keys()
    if not told and _others_run():
        os.environ["GOMP_SPINCOUNT"] = str(ACTIVE_WAITS)


def _others_run() -> bool:
    """Return whether each of some looks at Linux finds a second thread that runs or could."""
    for _ in range(LOOKS):
        try:
            ready = int(Path("/proc/loadavg").read_text().split()[3].partition("/")[0])
        except (IndexError, OSError, ValueError):
            return False
        if ready < 2:
            return False
        time.sleep(0.002)
    return True


def announce_training() -> None:
    """Print the command of `train` at once, since importing torch takes seconds."""
    words = command_words() or []
    if FIRST and words[:1] == ["train"] and not {"-h", "--help", "--version"} & set(words):
        import shlex
        import shutil  # takes a while to import

        with suppress(OSError, ValueError):  # of a closed or full output, or of invalid UTF-8
            width = shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize
            whole = f"starting: {shlex.join(words)}"
            print(whole if len(whole) <= width else "starting: train", flush=True)


def end_at_once_on_ctrl_c() -> None:
    """Let Ctrl-C end a command with one word while nothing is to be cleaned up: as it imports.

    An exception would come out of an import as a traceback, or be lost in one.
    """
    if command_words() is not None and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


def command_began() -> float:
    """Return the value that `time.perf_counter()` had when this command's process began.

    It is now if Python called the command, or if the system does not tell: only Linux does.
    """
    now = time.perf_counter()
    if command_words() is None:
        return now
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[START])
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (AttributeError, IndexError, OSError, ValueError):
        return now
    return now - max(0.0, age)
