"""Ctrl-C while a command still imports its libraries: one line instead of a traceback."""

import os
import sys
from itertools import pairwise
from pathlib import Path
from types import TracebackType

INTERRUPTED = 130  # the exit status of a program that Ctrl-C ended


def runs_a_command() -> bool:
    """Return whether this process was started as one of the commands of morlax_torch."""
    by_module = any(a == "-m" and b.startswith("morlax_torch") for a, b in pairwise(sys.orig_argv))
    names = [Path(word).stem for word in sys.orig_argv[:2]]
    by_script = any(name == "morlax" or name.startswith("morlax-") for name in names)
    return by_module or by_script


def report_interrupts_in_one_line() -> None:
    """Make an uncaught KeyboardInterrupt print one line and exit with status 130."""
    usual = sys.excepthook

    def report(
        kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        if not issubclass(kind, KeyboardInterrupt):
            usual(kind, error, trace)
            return
        sys.stdout.flush()
        print("interrupted", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)

    sys.excepthook = report
