"""Requests of browsers, executed one after the other by the thread that moves the robots."""

import logging
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Queue

from ...envs import MorlaxError

_log = logging.getLogger(__name__)
Put = Callable[[Callable[[], None]], None]  # queues a request


class Requests:
    """A queue of requests, run between two steps of the robots: no browser can interrupt a step.

    Args:
        tell: called with the reason why a request failed.
    """

    def __init__(self, tell: Callable[[str], None]):
        self._tell = tell
        # a SimpleQueue waits forever if a signal interrupts it about when its timeout ends
        self._queue: Queue[Callable[[], None]] = Queue()

    def put(self, request: Callable[[], None]) -> None:
        """Queue a request, from any thread."""
        self._queue.put(request)

    def execute(self, seconds: float) -> None:
        """Wait up to `seconds` for a request, then execute all that are queued."""
        with suppress(Empty):
            self.attempt(self._queue.get(timeout=seconds))
            for _ in range(self._queue.qsize()):
                self.attempt(self._queue.get_nowait())

    def attempt(self, action: Callable[[], object]) -> str | None:
        """Run `action`; if it fails, tell why, and return the reason."""
        try:
            action()
        except MorlaxError as error:
            text = str(error)
        except Exception as error:  # in the robot's own code, for example
            _log.exception("The page goes on after this error:")
            text = f"{type(error).__name__}: {error}"
        else:
            return None
        self._tell(text)
        return text
