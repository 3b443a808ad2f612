"""The widgets that every run shares: buttons, playback speed, status lines, a panel of plots."""

from collections.abc import Callable
from functools import partial
from typing import Any

import viser

from .lineup import MOST
from .session import PUSH
from .steering import Put

PAUSE, RESUME = "pause", "resume"
RESET, SHOVE = "reset", "push"
FIND = "A or B?"
ADD, DROP = "add a robot", "remove"


class Controls:
    """The buttons of all runs; the pressed ones act through `act`, except "pause" and "resume".

    `paused`, `pace` (1 is real time) and `failure` (why the robots paused by themselves, or None)
    are the state of the playback. `plots` is the container for drawings of a run.

    Args:
        gui: viser's widgets.
        put: queues a request of a browser.
        act: called with the label of a button that a user has pressed.
        select: called with the index of the robot that a user wants to steer.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        put: Put,
        act: Callable[[str], None],
        select: Callable[[int], None],
    ):
        self._put, self._act = put, act
        self.paused, self.pace = False, 1.0
        self.failure: str | None = None
        hint = (
            f"{FIND} finds your trade-off: you say which of two robots you like better. Or show "
            f"up to {MOST} robots with trade-offs of their own."
        )
        self._compare = gui.add_button_group("compare", (FIND, ADD), order=1.2, hint=hint)
        hint = "The robot that the sliders steer and the charts show."
        self._steered = gui.add_dropdown("steer robot", ("1",), order=1.3, visible=False, hint=hint)
        hint = f"A push adds {PUSH:g} m/s in a random horizontal direction."
        self._robot = gui.add_button_group("robot", (PAUSE, RESET, SHOVE), order=3, hint=hint)
        hint = "Playback speed; 1 is real time."
        pace = gui.add_slider("pace", 0.05, 1.0, 0.05, 1.0, order=4, hint=hint)
        self._status = gui.add_html("", order=5)
        panel = gui.add_panel()
        self.plots = panel.add_tab("front and charts")
        panel.dock_left()
        gui.main_panel.dock_right()

        self._compare.on_click(self._pressed)
        self._robot.on_click(self._pressed)

        @self._steered.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                put(partial(select, int(event.target.value) - 1))

        @pace.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            put(partial(self._set_pace, event.target.value))

    def pause(self, paused: bool, failure: str | None = None) -> None:
        """Pause or resume the robots; `failure` is why they pause by themselves."""
        self.paused, self.failure = paused, failure
        self._robot.options = (RESUME if paused else PAUSE, RESET, SHOVE)

    def offer(self, number: int, selected: int, comparing: bool) -> None:
        """Offer what can be done with the robots that there are.

        Args:
            number: of robots.
            selected: index of the robot that is steered.
            comparing: whether the mode "A or B?" is on, which hides these widgets.
        """
        more, fewer = (ADD,) * (number < MOST), (DROP,) * (number > 1)
        self._compare.visible = not comparing
        self._compare.options = (FIND, *more, *fewer)
        self._steered.visible = not comparing and number > 1
        self._steered.options = tuple(str(i + 1) for i in range(number))
        self._steered.value = str(selected + 1)

    def report(self, html: str | None) -> None:
        """Show the status lines; None hides them."""
        self._status.visible = html is not None
        if html is not None:
            self._status.content = html

    def _set_pace(self, pace: float) -> None:
        self.pace = pace

    async def _pressed(self, event: viser.GuiEvent[Any]) -> None:
        self._put(partial(self._react, event.target.value))

    def _react(self, pressed: str) -> None:
        if pressed in (PAUSE, RESUME):
            self.pause(pressed == PAUSE)
        else:
            self._act(pressed)
