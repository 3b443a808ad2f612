"""When a command began, which is before its libraries were imported."""

import os
import time
from pathlib import Path

from .startup import runs_a_command

START = 19  # position of a process's start in /proc/PID/stat, after its name in brackets


def command_began() -> float:
    """Return the value that `time.perf_counter()` had when this command's process began.

    It is now if Python called the command, or if the system does not tell: only Linux does.
    """
    now = time.perf_counter()
    if not runs_a_command():
        return now
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[START])
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (AttributeError, IndexError, OSError, ValueError):
        return now
    return now - max(0.0, age)
