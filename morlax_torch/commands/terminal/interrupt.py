"""Ctrl-C, SIGTERM and a lost terminal (SIGHUP): as a flag, or as the end of the program."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]

STUCK = 5.0  # seconds in which a process that is not stuck notices a signal

_noticed = threading.Event()  # set when Python has run one of the signal handlers below


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
    """Raise an exception for each of SIGNALS, so that `finally` removes temporary files."""

    def receive(number: int, frame: Any) -> None:
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(128 + number)

    with _handling(SIGNALS, receive):
        yield


@contextmanager
def exiting_when_stuck() -> Iterator[None]:
    """Exit on a SIGTERM that Python does not notice within STUCK seconds.

    Python runs signal handlers between its own instructions, but a process that waits for one that
    has ended, in NCCL or in a rendezvous, does not come back to them.
    """
    received, notice = os.pipe()
    os.set_blocking(notice, False)
    usual = signal.set_wakeup_fd(notice)
    thread = threading.Thread(target=_exit_when_stuck, args=(received,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(usual)
        os.close(notice)
        thread.join()
        os.close(received)


def _exit_when_stuck(received: int) -> None:
    while number := os.read(received, 1):
        if number[0] == signal.SIGTERM and not _noticed.wait(STUCK):
            os._exit(128 + signal.SIGTERM)


@contextmanager
def _handling(
    signals: list[signal.Signals], handle: Callable[[int, Any], None]
) -> Iterator[dict[signal.Signals, Any]]:
    def receive(number: int, frame: Any) -> None:
        _noticed.set()
        handle(number, frame)

    # nohup ignores SIGHUP, and shells ignore SIGINT for jobs in the background
    heard = [which for which in signals if signal.getsignal(which) != signal.SIG_IGN]
    usual = {which: signal.signal(which, receive) for which in heard}
    try:
        yield usual
    finally:
        for which, handler in usual.items():
            signal.signal(which, handler)
