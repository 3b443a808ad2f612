"""Ctrl-C and SIGTERM as a flag."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interruptible() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C or SIGTERM into a flag; a second one acts as usual."""
    pressed = False

    def press(number: int, frame: object) -> None:
        nonlocal pressed
        pressed = True
        for which, handler in usual.items():
            signal.signal(which, handler)

    usual = {which: signal.signal(which, press) for which in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: pressed
    finally:
        for which, handler in usual.items():
            signal.signal(which, handler)
