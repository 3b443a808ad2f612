"""The page: widgets that ask a session for something, and show what it does."""

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue

import rich
import viser

from ...envs import MorlaxError, title
from . import library
from .charts import Charts
from .drawing import Drawing
from .picking import FIELD, copy_button
from .scene import RobotScene
from .session import PUSH, Session
from .status import NO_FRONT, status
from .weights import Weights, move_slider, read, show

FRAME = 1 / 40  # s between drawings of the robot
CHART = 1 / 5  # s between drawings of the charts
LOOK = 3.0  # s between looks for new runs
USUAL_SIZE = 1.6  # m; the camera comes nearer to smaller robots
PAUSE, GO_ON = "pause", "go on"


class Page:
    """A viser server and the session that it shows; `serve` runs both.

    A callback only puts a wish into a queue, which the loop of `serve` grants between two steps:
    the session knows one thread, and browsers that come and go do not touch it.

    Raises:
        MorlaxError: the run is none, or has no checkpoint.
    """

    def __init__(self, run: str, host: str, port: int):
        self._choice = library.choose(run)
        self._session = Session(self._choice)
        self._wishes: SimpleQueue[Callable[[], None]] = SimpleQueue()
        rich.get_console().quiet = True  # viser's own banner: the command prints the address
        self.server = viser.ViserServer(host, port, verbose=False)
        self.server.scene.world_axes.visible = False
        self.server.scene.configure_fog(10.0, 30.0)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.server.initial_camera.fov = 0.8
        self.server.on_client_connect(self._fit_camera)
        self._add_widgets()
        self._add_session()

    def serve(self, ended: Callable[[], bool]) -> None:
        """Play in real time and serve browsers until `ended` says so."""
        frame = chart = look = 0.0
        while not ended():
            now = time.perf_counter()
            self._session.advance(now)
            if now >= frame:
                frame = now + FRAME
                self._draw()
            if now >= chart:
                chart = now + CHART
                self._charts.draw()
                self._status.content = status(self._session)
            if now >= look:
                look = now + LOOK
                self._look_for_runs()
            wait = min(self._session.until_next(), frame - time.perf_counter())
            self._grant_wishes(max(wait, 0.0))

    def stop(self) -> None:
        """Send the browsers away."""
        self.server.stop()

    def _grant_wishes(self, seconds: float) -> None:
        """Wait so long for a wish, and grant all there are."""
        try:
            self._wishes.get(timeout=seconds)()
            while True:
                self._wishes.get_nowait()()
        except Empty:
            return

    def _look_for_runs(self) -> None:
        runs = tuple(self._runs())
        if runs != self._run_choice.options:
            self._run_choice.options = runs

    def _runs(self) -> list[str]:
        runs = [*library.shipped(), *library.trained()]
        return runs if self._choice.run in runs else [self._choice.run, *runs]

    def _add_widgets(self) -> None:
        """What stays whatever is shown."""
        gui = self.server.gui
        self._run_choice = gui.add_dropdown(
            "policy",
            self._runs(),
            initial_value=self._choice.run,
            order=0,
            hint="those that ship, and the runs in ./runs",
        )
        self._checkpoint_choice = gui.add_dropdown(
            "checkpoint",
            list(self._choice.files),
            initial_value=self._choice.checkpoint,
            order=1,
        )
        self._actions = gui.add_button_group(
            "robot", (PAUSE, "reset", "push"), order=3, hint=f"a push adds {PUSH:g} m/s"
        )
        pace = gui.add_slider("pace", 0.05, 1.0, 0.05, 1.0, order=4, hint="1 is real time")
        self._status = gui.add_html("", order=5)
        panel = gui.add_panel()
        self._chart_tab = panel.add_tab("charts")
        panel.float(x=12, y=-12, width=320)

        @self._run_choice.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                run = event.target.value
                self._wishes.put(lambda: self._change(run, None))

        @self._checkpoint_choice.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                name = event.target.value
                self._wishes.put(lambda: self._change(self._choice.run, name))

        @self._actions.on_click
        async def _(event: viser.GuiEvent) -> None:
            action = event.target.value
            self._wishes.put(lambda: self._act(action))

        @pace.on_update
        async def _(event: viser.GuiEvent) -> None:
            value = event.target.value
            self._wishes.put(lambda: self._keep_pace(value))

    def _add_session(self) -> None:
        """What depends on the session: the robot, its objectives and its front."""
        session, gui = self._session, self.server.gui
        gui.set_panel_label(title(session.player.policy.config.env))
        camera, size = self.server.initial_camera, self._size
        camera.position, camera.look_at = (0.0, -4.6 * size, 1.6 * size), (0.0, 0.0, 0.55 * size)
        self._scene = RobotScene(self.server, session.player.model)
        self._drawing = Drawing(session.objectives, session.front)
        self._shown: Weights | None = None
        self._folder = gui.add_folder("how much each objective matters", order=2)
        with self._folder:
            self._sliders = [
                gui.add_slider(name, 0.0, 1.0, 0.01, round(weight, 2))
                for name, weight in zip(session.objectives, session.tradeoff, strict=True)
            ]
            self._field = gui.add_text(
                FIELD, show(session.tradeoff), hint="or type one: it is made to sum to one"
            )
            gui.add_html(copy_button())
            if session.front is None:
                gui.add_html(NO_FRONT)
            gui.add_html(self._drawing.html())
            self._marks = gui.add_html("")
        limits = session.player.env.command_limits
        self._commands = gui.add_folder("what the robot is told", order=1.5, visible=bool(limits))
        with self._commands:
            for index, (name, ends) in enumerate(limits.items()):
                told = session.player.command[index]
                self._tell(gui.add_slider(name, *ends, 0.01, round(told, 2)), session, index)
        with self._chart_tab:
            self._charts = Charts(self.server, session)
        for slider in self._sliders:
            self._listen(slider)

        @self._field.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                text = event.target.value
                self._wishes.put(lambda: self._type(text))

    def _listen(self, slider: viser.GuiSliderHandle[float]) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                value = event.target.value
                self._wishes.put(lambda: self._slide(slider, value))

    def _slide(self, slider: viser.GuiSliderHandle[float], value: float) -> None:
        if slider not in self._sliders:
            return  # it went with another session before its wish was granted
        index = self._sliders.index(slider)
        self._session.tradeoff = move_slider(self._session.tradeoff, index, value)
        self._field.value = show(self._session.tradeoff)

    def _tell(self, slider: viser.GuiSliderHandle[float], session: Session, index: int) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:
            value = event.target.value
            self._wishes.put(lambda: session.tell(index, value))

    def _type(self, text: str) -> None:
        # the field itself is left to whoever types in it
        weights = read(text, len(self._session.objectives))
        self._session.tradeoff = weights or self._session.tradeoff

    def _keep_pace(self, pace: float) -> None:
        self._session.pace = pace

    def _act(self, action: str) -> None:
        session = self._session
        if action == "reset":
            session.reset()
        elif action == "push":
            session.push()
        else:
            session.paused = action == PAUSE
            self._actions.options = (GO_ON if session.paused else PAUSE, "reset", "push")

    def _change(self, run: str, checkpoint: str | None) -> None:
        """Show another run or checkpoint; if it cannot be shown, say why and stay."""
        try:
            choice = library.choose(run, checkpoint)
            session = Session(choice)
        except MorlaxError as error:
            for client in self.server.get_clients().values():
                client.add_notification("It cannot be shown", str(error), color="red")
            choice = self._choice
        else:
            self._replace_session(session)
        self._choice = choice
        self._run_choice.value = choice.run
        self._checkpoint_choice.options = list(choice.files)
        self._checkpoint_choice.value = choice.checkpoint

    def _replace_session(self, session: Session) -> None:
        old, self._session = self._session, session
        session.paused, session.pace = old.paused, old.pace
        if session.objectives == old.objectives:
            session.tradeoff = old.tradeoff
        if session.player.env.command_limits == old.player.env.command_limits:
            session.player.command = old.player.command
        self._scene.remove()
        self._folder.remove()
        self._commands.remove()
        self._charts.remove()
        self._add_session()

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
        """Of the robot, relative to a usual one."""
        return self._session.player.model.stat.extent / USUAL_SIZE

    def _fit_camera(self, client: viser.ClientHandle) -> None:
        """On a phone the panel covers the lower half: show the robot above it."""
        camera, size = client.camera, self._size
        if camera.image_height > camera.image_width:
            camera.position = (0.0, -6.0 * size, 2.6 * size)
            camera.look_at = (0.0, 0.0, -1.35 * size)
