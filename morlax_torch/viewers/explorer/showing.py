"""The widgets that choose what is drawn: arrows, a trail, and a dark page."""

from collections.abc import Callable
from typing import Any

import viser

from .overlays import COMMAND, KINDS, Shown
from .steering import Put

HINTS = {
    "velocity": "Velocity of the robot's first moving body; the arrow looks 0.25 s ahead.",
    "command arrow": "Commanded velocity; an arrow of 1 m is 1 m/s.",
    "contact forces": "Force at each contact; half the robot's size is its weight.",
    "trail": "Where the robot came from.",
}


class Showing:
    """A folder of switches.

    Args:
        gui: viser's widgets.
        put: queues a request of a browser.
        shown: what is drawn; it is written to.
        darken: called with whether the page is to be dark.
    """

    def __init__(self, gui: viser.GuiApi, put: Put, shown: Shown, darken: Callable[[bool], None]):
        with gui.add_folder("show", order=6, expand_by_default=False):
            for kind in KINDS:
                box = gui.add_checkbox(kind, kind == COMMAND, hint=HINTS[kind])
                _send(box, put, lambda on, kind=kind: _switch(shown, kind, on))
            _send(gui.add_checkbox("dark page", False), put, darken)


def _switch(shown: Shown, kind: str, on: bool) -> None:
    shown.kinds = shown.kinds | {kind} if on else shown.kinds - {kind}


def _send(box: viser.GuiCheckboxHandle, put: Put, act: Callable[[bool], None]) -> None:
    @box.on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        value = event.target.value
        put(lambda: act(value))
