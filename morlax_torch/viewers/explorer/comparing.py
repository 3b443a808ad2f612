"""A page that only asks "A or B?", about behaviors from any source."""

import time
from collections.abc import Callable
from functools import partial

import rich

from . import access
from .asking import NAMES, Asking
from .behavior import MAX_LAG, Behavior
from .comparisons import Comparisons
from .overlays import Shown
from .serving import Requests
from .stage import Stage

FRAME = 1 / 40  # s between updates of the robots


class ComparisonPage:
    """A server that shows two robots and asks which one a user prefers; `serve` runs it.

    The source is used by the thread of `serve` only. `address` is what a browser must open.

    Args:
        source: of questions; it must have at least one.
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.

    Raises:
        MorlaxError: this version of viser cannot be protected from other web pages.
    """

    def __init__(self, source: Comparisons, host: str, port: int):
        rich.get_console().quiet = True  # hides viser's banner
        self._server, self.address = access.start(host, port)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.set_panel_label("A or B?")
        self._requests, self._stage = Requests(self._server), Stage(self._server, Shown())
        self._asking = Asking(self._server.gui, source, self._requests.put)
        self._shown: tuple[Behavior, ...] = ()
        self._draw()
        self._server.on_client_connect(self._stage.welcome)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Move the robots in real time and serve browsers until `ended` returns true."""
        while not ended():
            now = time.perf_counter()
            for behavior in self._shown:
                self._requests.attempt(partial(behavior.advance, now))
            self._draw()
            waits = [behavior.until_next() for behavior in self._shown]
            self._requests.execute(max(min(*waits, MAX_LAG), FRAME))

    def stop(self) -> None:
        """Stop the server and disconnect the browsers."""
        self._server.stop()

    def _draw(self) -> None:
        behaviors = self._asking.behaviors or self._shown  # the last ones stay when none is left
        if behaviors != self._shown:
            self._stage.show(behaviors, NAMES)
            self._shown = behaviors
        self._stage.draw()
