"""Requests of browsers, executed one after the other by the thread that runs the robots."""

import logging
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Queue

import viser

from ...envs import MorlaxError

_log = logging.getLogger(__name__)


class Requests:
    """A queue of requests. A failed one becomes a notification in every browser.

    viser's callbacks run on its event loop, so they only `put` requests; `execute` runs them
    between two steps of the robots. So no browser can interrupt a step.

    Args:
        server: viser's server.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
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
        """Run `action`; if it fails, tell all browsers why, and return the reason."""
        try:
            action()
        except MorlaxError as error:
            text = str(error)
        except Exception as error:  # in the robot's own code, for example
            _log.exception("The page goes on after this error:")
            text = f"{type(error).__name__}: {error}"
        else:
            return None
        for client in self._server.get_clients().values():
            tell(client, text)
        return text


def tell(client: viser.ClientHandle, text: str) -> None:
    """Show an error in one browser."""
    client.add_notification("Error", text, color="red")
