"""The widgets that set a trade-off: sliders, a text field and buttons."""

from collections.abc import Callable
from inspect import cleandoc
from typing import Any

import viser

from ...colors import of_objectives
from ...envs.worlds.robot import Robot
from .picking import FIELD, buttons, dot
from .session import Session
from .weights import Weights, move_slider, read, show

Put = Callable[[Callable[[], None]], None]  # executes a request in the thread of the page


class Steering:
    """Sliders for the weights of objectives, in the current GUI container.

    Args:
        gui: viser's widgets.
        session: whose objectives they are.
        put: queues a request of a browser.
        steer: called with the trade-off that a user has set.
    """

    def __init__(
        self, gui: viser.GuiApi, session: Session, put: Put, steer: Callable[[Weights], None]
    ):
        self._tradeoff, self._put, self._steer = session.tradeoff, put, steer
        self._sliders = []
        colors = of_objectives(len(session.objectives))
        for name, weight, color in zip(session.objectives, session.tradeoff, colors, strict=True):
            gui.add_html(dot(color))
            hint = explain(session.player.env, name)
            self._sliders.append(gui.add_slider(name, 0.0, 1.0, 0.01, round(weight, 2), hint=hint))
        hint = "Type a trade-off; it is rescaled to sum to one."
        self._field = gui.add_text(FIELD, show(session.tradeoff), hint=hint)
        gui.add_html(buttons(session.objectives))
        for index, slider in enumerate(self._sliders):
            self._send(slider, index)
        self._field.on_update(self._typed)

    def show(self, tradeoff: Weights, field: bool = True) -> None:
        """Show a trade-off; in the text field only if `field`, which may be in use."""
        self._tradeoff = tradeoff
        for slider, weight in zip(self._sliders, tradeoff, strict=True):
            slider.value = round(weight, 2)
        if field:
            self._field.value = show(tradeoff)

    def _send(self, slider: viser.GuiSliderHandle[float], index: int) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                value = event.target.value
                self._put(lambda: self._slide(index, value))

    def _slide(self, index: int, value: float) -> None:
        self._tradeoff = move_slider(self._tradeoff, index, value)
        self._field.value = show(self._tradeoff)
        self._steer(self._tradeoff)

    async def _typed(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            text = event.target.value
            self._put(lambda: self._type(text))

    def _type(self, text: str) -> None:
        # writing to the field here would disturb the user who is typing
        weights = read(text, len(self._sliders))
        if weights is not None:
            self._tradeoff = weights
            self._steer(weights)


def explain(env: Robot, objective: str) -> str:
    """Return an objective's weighted reward terms, and their docstrings.

    A term's docstring is that of the task's method of the same name, such as `energy`. Objectives
    that come from no such options, as in foreign tasks, have only their name.
    """
    options = getattr(env, "options", None)
    terms = getattr(options, "objectives", {}).get(objective)
    if not terms:
        return f"Weight of {objective}."
    shared = getattr(options, "shared", {})
    parts = [f"{weight:g} * {term}" for term, weight in terms.items()]
    text = f"{objective} = {' + '.join(parts)}".replace("+ -", "- ")
    if shared:
        names = " + ".join(f"{weight:g} * {term}" for term, weight in shared.items())
        text += f". Every objective also gets {names}".replace("+ -", "- ")
    notes = [f"{term}: {note}" for term in terms if (note := _docstring(env, term))]
    return ". ".join([text, *notes]).rstrip(".") + "."


def _docstring(env: Robot, term: str) -> str:
    """Return the first line of what a task says about one of its reward terms."""
    method = getattr(type(env), term.replace(" ", "_"), None)
    if not callable(method) or hasattr(Robot, term) or not method.__doc__:
        return ""
    return cleandoc(method.__doc__).splitlines()[0].rstrip(".")
