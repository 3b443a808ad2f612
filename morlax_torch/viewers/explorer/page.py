"""The page: widgets that control a session and show its state."""

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue

import rich
import viser

from ...envs import MorlaxError
from ...envs.naming import title
from . import access, library
from .charts import Charts
from .drawing import Drawing
from .picking import FIELD, copy_button
from .scene import RobotScene
from .session import PUSH, Session
from .status import NO_FRONT, status
from .weights import Weights, move_slider, read, show

FRAME = 1 / 40  # s between updates of the robot
CHART = 1 / 5  # s between updates of the charts
SCAN = 3.0  # s between searches for new runs
USUAL_SIZE = 1.6  # m; the camera moves closer to smaller robots
PAUSE, RESUME = "pause", "resume"
_log = logging.getLogger(__name__)


class Page:
    """A viser server and the session that it shows; `serve` runs both.

    Callbacks run on viser's event loop, so they only queue requests; the loop of `serve` executes
    them between two steps. Only its thread uses the session, so no browser can interrupt a step.
    A request or a step that fails becomes a notification on the page; a failed step also pauses the
    robot, and browsers that connect later are told why. `address` is what a browser must open; it
    contains a secret token.

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
        self._session = Session(self._choice)
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._failure: str | None = None  # why the robot paused by itself
        rich.get_console().quiet = True  # hides viser's banner; the command prints the address
        self.server, self.address = access.start(host, port)
        self.server.scene.world_axes.visible = False
        self.server.scene.configure_fog(10.0, 30.0)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.server.initial_camera.fov = 0.8
        self.server.on_client_connect(self._welcome)
        self._add_widgets()
        self._add_session(RobotScene(self.server, self._session.player.model))

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run the session in real time and serve browsers until `ended` returns true."""
        frame = chart = scan = 0.0
        while not ended():
            now = time.perf_counter()
            failure = self._attempt(partial(self._session.advance, now))
            if failure is not None:
                self._pause(True, failure)
            if now >= frame:
                frame = now + FRAME
                self._draw()
            if now >= chart:
                chart = now + CHART
                self._charts.draw()
                self._status.content = status(self._session)
            if now >= scan:
                scan = now + SCAN
                self._attempt(self._update_runs)
            wait = min(self._session.until_next(), frame - time.perf_counter())
            self._execute_requests(max(wait, 0.0))

    def stop(self) -> None:
        """Stop the server and disconnect the browsers."""
        self.server.stop()

    def _execute_requests(self, seconds: float) -> None:
        """Wait up to `seconds` for a request, then execute all that are queued."""
        with suppress(Empty):
            self._attempt(self._requests.get(timeout=seconds))
            for _ in range(self._requests.qsize()):
                self._attempt(self._requests.get_nowait())

    def _attempt(self, action: Callable[[], object]) -> str | None:
        """Run `action`; if it fails, tell all browsers why, and return it."""
        try:
            action()
        except MorlaxError as error:
            text = str(error)
        except Exception as error:  # in the robot's own code, for example
            _log.exception("The page goes on after this error:")
            text = f"{type(error).__name__}: {error}"
        else:
            return None
        for client in self.server.get_clients().values():
            _tell(client, text)
        return text

    def _update_runs(self) -> None:
        runs = tuple(self._runs())
        if runs != self._run_choice.options:
            self._run_choice.options = runs

    def _runs(self) -> list[str]:
        runs = [*library.shipped(), *library.trained()]
        return runs if self._choice.run in runs else [self._choice.run, *runs]

    def _add_widgets(self) -> None:
        """Add the widgets that every session shares."""
        gui = self.server.gui
        self._run_choice = gui.add_dropdown(
            "policy",
            self._runs(),
            initial_value=self._choice.run,
            order=0,
            hint="Shipped policies, and the runs in ./runs.",
        )
        self._checkpoint_choice = gui.add_dropdown(
            "checkpoint",
            list(self._choice.files),
            initial_value=self._choice.checkpoint,
            order=1,
        )
        self._actions = gui.add_button_group(
            "robot",
            (PAUSE, "reset", "push"),
            order=3,
            hint=f"A push adds {PUSH:g} m/s in a random horizontal direction.",
        )
        hint = "Playback speed; 1 is real time."
        pace = gui.add_slider("pace", 0.05, 1.0, 0.05, 1.0, order=4, hint=hint)
        self._status = gui.add_html("", order=5)
        panel = gui.add_panel()
        self._chart_tab = panel.add_tab("charts")
        panel.float(x=12, y=-12, width=320)

        @self._run_choice.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                run = event.target.value
                self._requests.put(lambda: self._change(run, None))

        @self._checkpoint_choice.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                name = event.target.value
                self._requests.put(lambda: self._change(self._choice.run, name))

        @self._actions.on_click
        async def _(event: viser.GuiEvent) -> None:
            action = event.target.value
            self._requests.put(lambda: self._act(action))

        @pace.on_update
        async def _(event: viser.GuiEvent) -> None:
            value = event.target.value
            self._requests.put(lambda: self._set_pace(value))

    def _add_session(self, scene: RobotScene) -> None:
        """Add what depends on the session: its objectives, commands and front."""
        session, gui = self._session, self.server.gui
        gui.set_panel_label(title(session.player.policy.config.env))
        camera, size = self.server.initial_camera, self._size
        camera.position, camera.look_at = (0.0, -4.6 * size, 1.6 * size), (0.0, 0.0, 0.55 * size)
        self._scene = scene
        self._drawing = Drawing(session.objectives, session.front)
        self._shown: Weights | None = None
        self._folder = gui.add_folder("objective weights", order=2)
        with self._folder:
            self._sliders = [
                gui.add_slider(name, 0.0, 1.0, 0.01, round(weight, 2))
                for name, weight in zip(session.objectives, session.tradeoff, strict=True)
            ]
            self._field = gui.add_text(
                FIELD,
                show(session.tradeoff),
                hint="Type a trade-off; it is rescaled to sum to one.",
            )
            gui.add_html(copy_button())
            if session.front is None:
                gui.add_html(NO_FRONT)
            gui.add_html(self._drawing.html())
            self._marks = gui.add_html("")
        limits = session.player.env.command_limits
        self._commands = gui.add_folder("command", order=1.5, visible=bool(limits))
        with self._commands:
            for index, (name, ends) in enumerate(limits.items()):
                commanded = min(max(round(session.player.command[index], 2), ends[0]), ends[1])
                slider = gui.add_slider(name, *ends, 0.01, commanded)
                self._send_commands(slider, session, index)
        with self._chart_tab:
            self._charts = Charts(self.server, session)
        for slider in self._sliders:
            self._send_weights(slider)

        @self._field.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                text = event.target.value
                self._requests.put(lambda: self._type(text))

    def _send_weights(self, slider: viser.GuiSliderHandle[float]) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                value = event.target.value
                self._requests.put(lambda: self._slide(slider, value))

    def _slide(self, slider: viser.GuiSliderHandle[float], value: float) -> None:
        if slider not in self._sliders:
            return  # its session was replaced before this request was executed
        index = self._sliders.index(slider)
        self._session.tradeoff = move_slider(self._session.tradeoff, index, value)
        self._field.value = show(self._session.tradeoff)

    def _send_commands(
        self, slider: viser.GuiSliderHandle[float], session: Session, index: int
    ) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:
            value = event.target.value
            self._requests.put(lambda: session.tell(index, value))

    def _type(self, text: str) -> None:
        # writing to the field here would disturb the user who is typing
        weights = read(text, len(self._session.objectives))
        self._session.tradeoff = weights or self._session.tradeoff

    def _set_pace(self, pace: float) -> None:
        self._session.pace = pace

    def _act(self, action: str) -> None:
        session = self._session
        if action == "reset":
            session.reset()
        elif action == "push":
            session.push()
        else:
            self._pause(action == PAUSE)

    def _pause(self, paused: bool, failure: str | None = None) -> None:
        self._session.paused, self._failure = paused, failure
        self._actions.options = (RESUME if paused else PAUSE, "reset", "push")

    def _change(self, run: str, checkpoint: str | None) -> None:
        """Show another run or checkpoint; if that fails, keep this one."""
        try:
            choice = library.choose(run, checkpoint)
            self._replace_session(Session(choice))
            self._choice = choice
        finally:  # the dropdowns name the run that is shown
            self._run_choice.value = self._choice.run
            self._checkpoint_choice.options = list(self._choice.files)
            self._checkpoint_choice.value = self._choice.checkpoint

    def _replace_session(self, session: Session) -> None:
        scene = RobotScene(self.server, session.player.model)  # may fail, so it comes first
        old, self._session, self._failure = self._session, session, None
        session.paused, session.pace = old.paused, old.pace
        if session.objectives == old.objectives:
            session.tradeoff = old.tradeoff
        if session.player.env.command_limits == old.player.env.command_limits:
            session.player.command = old.player.command
        self._scene.remove()
        self._folder.remove()
        self._commands.remove()
        self._charts.remove()
        self._add_session(scene)

    def _draw(self) -> None:
        session = self._session
        self._scene.draw(session.player.data)
        if session.tradeoff != self._shown:
            self._shown = session.tradeoff
            self._marks.content = self._drawing.marks(session.tradeoff, session.nearest())
            for slider, weight in zip(self._sliders, session.tradeoff, strict=True):
                slider.value = round(weight, 2)

    @property
    def _size(self) -> float:
        """Size of the robot relative to `USUAL_SIZE`."""
        return self._session.player.model.stat.extent / USUAL_SIZE

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Fit the camera of a new browser, and tell it why the robot stands still."""
        if self._failure is not None:
            _tell(client, self._failure)
        self._fit_camera(client)

    def _fit_camera(self, client: viser.ClientHandle) -> None:
        """Show the robot in the upper half on a phone, where the panel covers the lower half."""
        camera, size = client.camera, self._size
        if camera.image_height <= camera.image_width:
            return
        with suppress(ValueError):  # viser cannot move a camera that looks at its own position
            camera.position = (0.0, -6.0 * size, 2.6 * size)
            camera.look_at = (0.0, 0.0, -1.35 * size)


def _tell(client: viser.ClientHandle, text: str) -> None:
    client.add_notification("Error", text, color="red")
