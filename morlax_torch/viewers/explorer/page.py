"""The page: a server, the robots that it shows, and the widgets that control them."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import rich
import viser

from ...envs.naming import title
from . import access, library
from .asking import NAMES
from .behavior import MAX_LAG, Behavior
from .charts import Charts
from .commands import Commands
from .finding import Finding
from .front_view import FrontView
from .lineup import MOST, Lineup
from .menu import Menu
from .overlays import Shown
from .serving import Requests, tell
from .session import PUSH, Session
from .showing import Showing
from .stage import Stage
from .status import status
from .steering import Steering
from .thresholds import Thresholds
from .weights import Weights

FRAME = 1 / 40  # s between updates of the robots
CHART = 1 / 5  # s between updates of the charts
SCAN = 3.0  # s between searches for new runs
PAUSE, RESUME = "pause", "resume"
FIND = "A or B?"
ADD, DROP = "add a robot", "remove"


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
        self._failure: str | None = None  # why the robots paused by themselves
        self._paused, self._pace = False, 1.0
        rich.get_console().quiet = True  # hides viser's banner; the command prints the address
        self.server, self.address = access.start(host, port)
        self._requests = Requests(self.server)
        self._shown = Shown()
        self._stage = Stage(self.server, self._shown)
        self._darken(False)
        self._add_widgets()
        self._set_stage((session,), ())
        self._begin(session)
        self.server.on_client_connect(self._welcome)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run the robots in real time and serve browsers until `ended` returns true."""
        frame = chart = scan = 0.0
        while not ended():
            now = time.perf_counter()
            failure = self._requests.attempt(partial(self._advance, now))
            if failure is not None:
                self._pause(True, failure)
            if now >= frame:
                frame = now + FRAME
                self._draw()
            if now >= chart:
                chart = now + CHART
                self._report()
            if now >= scan:
                scan = now + SCAN
                self._requests.attempt(self._menu.refresh)
            waits = [behavior.until_next() for behavior in self._behaviors]
            wait = min(*waits, MAX_LAG, frame - time.perf_counter())
            self._requests.execute(max(wait, 0.0))

    def stop(self) -> None:
        """Stop the server and disconnect the browsers."""
        self.server.stop()

    # what every run shares

    def _add_widgets(self) -> None:
        gui, put = self.server.gui, self._requests.put
        self._menu = Menu(gui, self._choice, put, self._change)
        hint = (
            f"{FIND} finds your trade-off: you say which of two robots you like better. Or show "
            f"up to {MOST} robots with trade-offs of their own."
        )
        self._compare = gui.add_button_group("compare", (FIND, ADD), order=1.2, hint=hint)
        hint = f"A push adds {PUSH:g} m/s in a random horizontal direction."
        self._actions = gui.add_button_group("robot", (PAUSE, "reset", "push"), order=3, hint=hint)
        hint = "The robot that the sliders steer and the charts show."
        self._steered = gui.add_dropdown("steer robot", ("1",), order=1.3, visible=False, hint=hint)
        hint = "Playback speed; 1 is real time."
        pace = gui.add_slider("pace", 0.05, 1.0, 0.05, 1.0, order=4, hint=hint)
        self._status = gui.add_html("", order=5)
        Showing(gui, put, self._shown, self._darken)
        panel = gui.add_panel()
        self._plots = panel.add_tab("front and charts")
        panel.dock_left()
        gui.main_panel.dock_right()

        self._actions.on_click(self._on_press)
        self._compare.on_click(self._on_press)

        @self._steered.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                index = int(event.target.value) - 1
                put(partial(self._select, index))

        @pace.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            put(partial(self._set_pace, event.target.value))

    async def _on_press(self, event: viser.GuiEvent[Any]) -> None:
        self._requests.put(partial(self._act, event.target.value))

    def _act(self, action: str) -> None:
        if action == FIND:
            self._find()
        elif action == ADD:
            self._lineup.add()
            self._update_choices()
        elif action == DROP:
            self._lineup.remove()
            self._update_choices()
        elif action == "reset":
            for behavior in self._behaviors:
                behavior.reset()
        elif action == "push":
            for session in self._all_sessions():
                session.push()
        else:
            self._pause(action == PAUSE)

    def _pause(self, paused: bool, failure: str | None = None) -> None:
        self._paused, self._failure = paused, failure
        self._actions.options = (RESUME if paused else PAUSE, "reset", "push")

    def _set_pace(self, pace: float) -> None:
        self._pace = pace

    # what depends on the run

    def _begin(self, session: Session) -> None:
        """Add the widgets of a run; its robot is on the stage."""
        gui, put = self.server.gui, self._requests.put
        gui.set_panel_label(title(session.player.policy.config.env))
        self._lineup = Lineup(session)
        self._finding: Finding | None = None
        self._marked: object = None
        self._folder = gui.add_folder("objective weights", order=2)
        with self._folder:
            self._steering = Steering(gui, session, put, self._steer)
        evaluated = session.front is not None
        self._at_least = gui.add_folder(
            "at least", order=2.5, expand_by_default=False, visible=evaluated
        )
        self._thresholds = None
        if session.front is not None:
            with self._at_least:
                self._thresholds = Thresholds(gui, session.front, put, self._jump)
        self._commands = Commands(gui, session, put, self._command)
        with self._plots:
            self._front = FrontView(gui, session, put)
            self._charts = Charts(self.server, session)
        self._update_choices()

    def _end(self) -> None:
        """Remove the widgets that `_begin` has added."""
        self._leave(None)
        for part in (self._folder, self._at_least, self._commands, self._front, self._charts):
            part.remove()

    def _change(self, run: str, checkpoint: str | None) -> None:
        """Show another run or checkpoint; if that fails, keep this one."""
        try:
            choice = library.choose(run, checkpoint)
            self._replace(Session.open(choice))
            self._choice = choice
        finally:  # the dropdowns name the run that is shown
            self._menu.show(self._choice)

    def _replace(self, session: Session) -> None:
        old = self._lineup.steered
        if session.objectives == old.objectives:
            session.tradeoff = old.tradeoff
        if session.player.env.command_limits == old.player.env.command_limits:
            session.player.command = old.player.command
        self._set_stage((session,), ())  # may fail, so it comes first
        self._failure = None
        self._end()
        self._begin(session)

    def _steer(self, tradeoff: Weights) -> None:
        self._lineup.steered.tradeoff = tradeoff

    def _jump(self, tradeoff: Weights) -> None:
        """Steer to a trade-off that does not come from the sliders."""
        self._steer(tradeoff)
        self._steering.show(tradeoff)

    def _command(self, index: int, value: float) -> None:
        for session in self._all_sessions():
            session.tell(index, value)

    # several robots

    def _select(self, index: int) -> None:
        if index < len(self._lineup.sessions):
            self._lineup.selected = index
            self._steering.show(self._lineup.steered.tradeoff)

    def _update_choices(self) -> None:
        """Offer what can be done with the robots that there are."""
        number, finding = len(self._lineup.sessions), self._finding is not None
        self._compare.visible = self._folder.visible = not finding
        self._at_least.visible = not finding and self._thresholds is not None
        more, fewer = (ADD,) * (number < MOST), (DROP,) * (number > 1)
        self._compare.options = (FIND, *more, *fewer)
        self._steered.visible = not finding and number > 1
        self._steered.options = tuple(str(i + 1) for i in range(number))
        self._steered.value = str(self._lineup.selected + 1)
        self._steering.show(self._lineup.steered.tradeoff)

    def _find(self) -> None:
        """Enter the mode "A or B?"."""
        if self._finding is None:
            session = self._lineup.steered
            self._finding = Finding(self.server.gui, session, self._requests.put, self._leave)
            self._update_choices()

    def _leave(self, tradeoff: Weights | None) -> None:
        """Leave the mode "A or B?"; with a trade-off, go on with it."""
        if self._finding is None:
            return
        self._finding.remove()
        self._finding = None
        if tradeoff is not None:
            self._jump(tradeoff)
        self._update_choices()

    @property
    def _behaviors(self) -> Sequence[Behavior]:
        """What is on the stage and moves."""
        compared = self._finding.behaviors if self._finding else ()
        return compared or self._lineup.sessions

    def _all_sessions(self) -> list[Session]:
        compared = [b for b in self._behaviors if isinstance(b, Session)]
        return list({*self._lineup.sessions, *compared})

    def _advance(self, now: float) -> None:
        for behavior in self._behaviors:
            behavior.paused, behavior.pace = self._paused, self._pace
            behavior.advance(now)

    # the scene

    def _draw(self) -> None:
        behaviors = tuple(self._behaviors)
        compared = self._finding is not None and bool(self._finding.behaviors)
        names = NAMES if compared else self._lineup.names()
        if behaviors != self._on_stage:
            self._set_stage(behaviors, names)
        self._stage.rename(names)
        self._stage.draw()
        self._mark()

    def _report(self) -> None:
        """Show the robots' returns and charts; "A or B?" is to be answered without numbers."""
        lineup = self._lineup
        self._status.visible = self._behaviors is lineup.sessions
        if self._status.visible:
            self._charts.draw(lineup.steered)
            self._status.content = status(lineup.sessions, lineup.selected)

    def _set_stage(self, behaviors: tuple[Behavior, ...], names: Sequence[str]) -> None:
        self._stage.show(behaviors, names)
        self._on_stage = behaviors

    def _mark(self) -> None:
        """Show the current trade-offs on the sliders and in the drawing, if they have changed."""
        lineup = self._lineup
        levels = dict(self._thresholds.levels) if self._thresholds else {}
        tradeoffs = [session.tradeoff for session in lineup.sessions]
        marked = (tradeoffs, lineup.selected, levels, self._front.drawing)
        if marked != self._marked:
            self._marked = marked
            self._front.mark(lineup.sessions, lineup.selected, levels)
            self._steering.show(lineup.steered.tradeoff, field=False)

    def _darken(self, dark: bool) -> None:
        self.server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
        self._stage.darken(dark)

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Fit the camera of a new browser, and tell it why the robots stand still."""
        if self._failure is not None:
            tell(client, self._failure)
        self._stage.welcome(client)
