"""The widgets that choose a trade-off by what its policy must reach."""

import math
import threading
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import viser

from ...colors import of_objectives
from ...envs import MorlaxError
from ...evaluation.front import Front
from ...evaluation.requirements import Choice
from ...networks.policy import Policy
from ...runs.choosing import Chooser
from .picking import dot
from .steering import Put
from .weights import Weights

STEPS = 100  # of a slider, about
OFF = "thresholds off"
SEARCHING = "Simulating policies…"

Wanted = tuple[dict[str, float], str]  # required returns, and the objective to maximize


class Thresholds:
    """A slider "at least" per objective, off at its left end, and the objective to maximize.

    A thread of its own simulates, one search after the other, while the robots go on.

    Args:
        gui: viser's widgets; these are added to the current container.
        policy: to simulate, on the CPU.
        front: evaluated trade-offs to start from.
        put: queues a request of a browser.
        steer: called with the trade-off that was found.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        policy: Policy,
        front: Front,
        put: Put,
        steer: Callable[[Weights], None],
    ):
        self._policy, self._front, self._put, self._steer = policy, front, put, steer
        self._chooser: Chooser | None = None
        self._wanted: Wanted | None = None  # by the user; None: no thresholds
        self.searching = False
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

    @property
    def result(self) -> str:
        """HTML of what the last search found, or that one goes on."""
        return self._result.content

    def stop(self) -> None:
        """Ignore what the current search will find."""
        self._wanted = None

    def _send(self, slider: viser.GuiSliderHandle[float], index: int) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                value = event.target.value
                self._put(partial(self.require, index, value))

    async def _maximized(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            self._put(self._choose)

    async def _switched_off(self, event: viser.GuiEvent[Any]) -> None:
        self._put(self._clear)

    def require(self, index: int, least: float) -> None:
        """Require a return of an objective, by its index, and search."""
        if least > self._sliders[index].min:
            self.levels[index] = least
        else:
            self.levels.pop(index, None)
        self._choose()

    def _clear(self) -> None:
        self.levels.clear()
        for slider in self._sliders:
            slider.value = slider.min
        self._wanted, self._result.content = None, ""

    def _choose(self) -> None:
        """Search for the trade-off that meets the thresholds, now or after the current search."""
        names = self._front.objectives
        required = {names[index]: least for index, least in self.levels.items()}
        self._wanted = required, self._maximize.value
        if not self.searching:
            self.searching = True
            self._result.content = _line(SEARCHING, "searching")
            threading.Thread(target=self._search, args=self._wanted, daemon=True).start()

    def _search(self, required: dict[str, float], maximize: str) -> None:
        """Search in another thread, and queue what follows."""
        found: Choice | Exception
        try:
            if self._chooser is None:
                self._chooser = Chooser(self._policy, self._front)
            found = self._chooser.choose(required, maximize)
        except Exception as error:  # raised again where it can be shown
            found = error
        self._put(lambda: self._show((required, maximize), found))

    def _show(self, wanted: Wanted, found: Choice | Exception) -> None:
        """Steer to a choice, or say why there is none, unless the user wants another by now."""
        self.searching = False
        if self._wanted is not None and self._wanted != wanted:
            self._choose()
        elif self._wanted is None:
            return
        elif isinstance(found, Choice):
            returns = ", ".join(f"{name} {value:,.0f}" for name, value in found.returns.items())
            self._result.content = _line(f"Simulated returns: {returns}.", "expected")
            self._steer(found.tradeoff)
        else:
            failed = isinstance(found, MorlaxError)
            self._result.content = _line(str(found), "infeasible") if failed else ""
            if not failed:
                raise found


def scale(low: float, high: float) -> tuple[float, float, float]:
    """Return the ends and the step of a slider over a range, as round numbers."""
    step = 10.0 ** math.floor(math.log10(max(high - low, 1e-6) / STEPS) + 1)
    step = step / 5 if (high - low) / step < STEPS / 4 else step
    digits = max(0, 1 - math.floor(math.log10(step)))
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    return round(low, digits), round(max(high, low + step), digits), round(step, digits)


def _line(text: str, kind: str) -> str:
    color = "color:#e8590c;" if kind == "infeasible" else ""
    style = f"margin:0;padding:0 0.8em 0.6em;font-size:0.85em;{color}"
    return f'<p data-{kind} style="{style}">{escape(text)}</p>'
