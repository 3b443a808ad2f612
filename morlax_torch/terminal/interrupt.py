"""Ctrl-C, SIGTERM and a lost terminal (SIGHUP) as a flag."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


class Interruption:
    """Whether a signal has asked the program to end; call it to ask."""

    signal: int = 0

    def __call__(self) -> bool:
        return self.signal != 0

    @property
    def exit_status(self) -> int:
        """0, or 128 plus the signal, as shells report it: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + self.signal if self.signal else 0


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Turn the first signal of SIGNALS into a flag; a second one acts as usual."""
    interruption = Interruption()

    def receive(number: int, frame: Any) -> None:
        interruption.signal = number
        for which, handler in usual.items():
            signal.signal(which, handler)

    with _handling(SIGNALS, receive) as usual:
        yield interruption


@contextmanager
def exiting_on_signals() -> Iterator[None]:
    """Exit on SIGTERM and SIGHUP by an exception, so that `finally` removes temporary files."""
    signals = [which for which in SIGNALS if which != signal.SIGINT]
    with _handling(signals, lambda number, frame: sys.exit(128 + number)):
        yield


@contextmanager
def _handling(
    signals: list[signal.Signals], handle: Callable[[int, Any], None]
) -> Iterator[dict[signal.Signals, Any]]:
    usual = {which: signal.signal(which, handle) for which in signals}
    try:
        yield usual
    finally:
        for which, handler in usual.items():
            signal.signal(which, handler)
