"""Sliders for the task's command, such as a velocity."""

from collections.abc import Callable
from functools import partial
from typing import Any

import viser

from .session import Session
from .steering import Put


class Commands:
    """A folder with a slider for each number of the command; hidden if the task has none.

    Args:
        gui: viser's widgets.
        session: whose command is shown.
        put: queues a request of a browser.
        tell: called with the index and the value of a number that a user has set.
    """

    def __init__(
        self, gui: viser.GuiApi, session: Session, put: Put, tell: Callable[[int, float], None]
    ):
        limits = session.player.env.command_limits
        self._folder = gui.add_folder("command", order=1.5, visible=bool(limits))
        with self._folder:
            for index, (name, ends) in enumerate(limits.items()):
                commanded = min(max(round(session.player.command[index], 2), ends[0]), ends[1])
                slider = gui.add_slider(name, *ends, 0.01, commanded)
                _send(slider, put, partial(tell, index))

    def remove(self) -> None:
        """Remove the folder from the page."""
        self._folder.remove()


def _send(slider: viser.GuiSliderHandle[float], put: Put, tell: Callable[[float], None]) -> None:
    @slider.on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        value = event.target.value
        put(partial(tell, value))
