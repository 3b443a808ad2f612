"""The page: a server, the robots on its stage, and the loop that runs both."""

import time
from collections.abc import Callable
from functools import partial

import rich
import viser

from . import access, library
from .behavior import MAX_LAG
from .controls import Controls
from .menu import Menu
from .overlays import Shown
from .run_panel import RunPanel
from .serving import Requests, tell
from .session import Session
from .showing import Showing
from .stage import Stage

FRAME = 1 / 40  # s between updates of the robots
CHART = 1 / 5  # s between updates of the charts
SCAN = 3.0  # s between searches for new runs


class Page:
    """A viser server and the robots that it shows; `serve` runs both.

    Only the thread of `serve` uses the robots: browsers queue their requests. A step that fails
    also pauses the robots, and browsers that connect later are told why. `address` is what a
    browser must open; it contains a secret token.

    Args:
        run: a run's folder, a checkpoint file, or a shipped policy.
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.

    Raises:
        MorlaxError: there is no such run, it has no checkpoint, or this version of viser cannot be
            protected from other web pages.
    """

    def __init__(self, run: str, host: str, port: int):
        self._choice = library.choose(run)
        session = Session.open(self._choice)
        rich.get_console().quiet = True  # hides viser's banner; the command prints the address
        self.server, self.address = access.start(host, port)
        self._requests, shown = Requests(self.server), Shown()
        gui, put = self.server.gui, self._requests.put
        self._stage = Stage(self.server, shown)
        self._darken(False)
        self._menu = Menu(gui, self._choice, put, self._change)
        self._controls = Controls(gui, put, self._act, self._select)
        Showing(gui, put, shown, self._darken)
        self._stage.show((session,), ())
        self._panel = RunPanel(self.server, session, put, self._controls)
        self.server.on_client_connect(self._welcome)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run the robots in real time and serve browsers until `ended` returns true."""
        frame = chart = scan = 0.0
        while not ended():
            now = time.perf_counter()
            failure = self._requests.attempt(partial(self._advance, now))
            if failure is not None:
                self._controls.pause(True, failure)
            if now >= frame:
                frame = now + FRAME
                self._draw()
            if now >= chart:
                chart = now + CHART
                self._panel.report()
            if now >= scan:
                scan = now + SCAN
                self._requests.attempt(self._menu.refresh)
            waits = [behavior.until_next() for behavior in self._panel.behaviors]
            wait = min(*waits, MAX_LAG, frame - time.perf_counter())
            self._requests.execute(max(wait, 0.0))

    def stop(self) -> None:
        """Stop the server and disconnect the browsers."""
        self.server.stop()

    def _advance(self, now: float) -> None:
        controls = self._controls
        for behavior in self._panel.behaviors:
            behavior.paused, behavior.pace = controls.paused, controls.pace
            behavior.advance(now)

    def _draw(self) -> None:
        behaviors, names = tuple(self._panel.behaviors), self._panel.names
        if behaviors != self._stage.behaviors:
            self._stage.show(behaviors, names)
        self._stage.rename(names)
        self._stage.draw()
        self._panel.mark()

    def _act(self, action: str) -> None:
        self._panel.act(action)

    def _select(self, index: int) -> None:
        self._panel.select(index)

    def _change(self, run: str, checkpoint: str | None) -> None:
        """Show another run or checkpoint; if that fails, keep this one."""
        try:
            choice = library.choose(run, checkpoint)
            self._replace(Session.open(choice))
            self._choice = choice
        finally:  # the dropdowns name the run that is shown
            self._menu.show(self._choice)

    def _replace(self, session: Session) -> None:
        old = self._panel.steered
        if session.objectives == old.objectives:
            session.tradeoff = old.tradeoff
        if session.player.env.command_limits == old.player.env.command_limits:
            session.player.command = old.player.command
        self._stage.show((session,), ())  # may fail, so it comes first
        self._controls.failure = None
        self._panel.remove()
        self._panel = RunPanel(self.server, session, self._requests.put, self._controls)

    def _darken(self, dark: bool) -> None:
        self.server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
        self._stage.darken(dark)

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Fit the camera of a new browser, and tell it why the robots stand still."""
        if self._controls.failure is not None:
            tell(client, self._controls.failure)
        self._stage.welcome(client)
