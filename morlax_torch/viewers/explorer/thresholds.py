"""The widgets that choose a trade-off by what its policy must reach."""

import math
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import viser

from ...colors import of_objectives
from ...envs import MorlaxError
from ...evaluation.choosing import choose
from ...evaluation.front import Front
from .picking import dot
from .steering import Put
from .weights import Weights

STEPS = 100  # of a slider, about
OFF = "thresholds off"


class Thresholds:
    """A slider "at least" per objective, off at its left end, and the objective to maximize.

    Args:
        gui: viser's widgets; these are added to the current container.
        front: evaluated trade-offs to choose from.
        put: queues a request of a browser.
        steer: called with the trade-off that was found.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        front: Front,
        put: Put,
        steer: Callable[[Weights], None],
    ):
        self._front, self._put, self._steer = front, put, steer
        self.levels: dict[int, float] = {}  # required returns by index of the objective
        hint = "The objective to get as much of as the thresholds allow."
        self._maximize = gui.add_dropdown("maximize", front.objectives, hint=hint)
        self._sliders = []
        colors = of_objectives(len(front.objectives))
        for name, returns, color in zip(front.objectives, front.returns.T, colors, strict=True):
            low, high, step = scale(float(returns.min()), float(returns.max()))
            gui.add_html(dot(color))
            hint = f"Least return of {name} per episode; off at the left end."
            self._sliders.append(gui.add_slider(f"{name} ≥", low, high, step, low, hint=hint))
        self._off = gui.add_button_group("", (OFF,))
        self._result = gui.add_html("")
        for index, slider in enumerate(self._sliders):
            self._send(slider, index)
        self._maximize.on_update(self._maximized)
        self._off.on_click(self._switched_off)

    def _send(self, slider: viser.GuiSliderHandle[float], index: int) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                value = event.target.value
                self._put(partial(self._require, index, value))

    async def _maximized(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            self._put(self._choose)

    async def _switched_off(self, event: viser.GuiEvent[Any]) -> None:
        self._put(self._clear)

    def _require(self, index: int, least: float) -> None:
        if least > self._sliders[index].min:
            self.levels[index] = least
        else:
            self.levels.pop(index, None)
        self._choose()

    def _clear(self) -> None:
        self.levels.clear()
        for slider in self._sliders:
            slider.value = slider.min
        self._result.content = ""

    def _choose(self) -> None:
        """Steer to the trade-off that meets the thresholds, or say why no trade-off does."""
        names = self._front.objectives
        required = {names[index]: least for index, least in self.levels.items()}
        try:
            choice = choose(self._front, required, self._maximize.value)
        except MorlaxError as error:
            self._result.content = _line(str(error), failed=True)
        else:
            expected = ", ".join(f"{name} {value:,.0f}" for name, value in choice.returns.items())
            self._result.content = _line(f"Expected returns: {expected}.", failed=False)
            self._steer(choice.tradeoff)


def scale(low: float, high: float) -> tuple[float, float, float]:
    """Return the ends and the step of a slider over a range, as round numbers."""
    step = 10.0 ** math.floor(math.log10(max(high - low, 1e-6) / STEPS) + 1)
    step = step / 5 if (high - low) / step < STEPS / 4 else step
    digits = max(0, 1 - math.floor(math.log10(step)))
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    return round(low, digits), round(max(high, low + step), digits), round(step, digits)


def _line(text: str, failed: bool) -> str:
    color = "color:#e8590c;" if failed else ""
    mark = "data-infeasible" if failed else "data-expected"
    style = f"margin:0;padding:0 0.8em 0.6em;font-size:0.85em;{color}"
    return f'<p {mark} style="{style}">{escape(text)}</p>'
