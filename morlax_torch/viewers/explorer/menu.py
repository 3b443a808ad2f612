"""The dropdowns of runs and checkpoints."""

from collections.abc import Callable
from typing import Any

import viser

from . import library
from .library import Choice
from .steering import Put


class Menu:
    """Two dropdowns at the top of the panel.

    Args:
        gui: viser's widgets.
        choice: the checkpoint that is shown.
        put: queues a request of a browser.
        change: called with a run, and a checkpoint of it or None for the best one.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        choice: Choice,
        put: Put,
        change: Callable[[str, str | None], None],
    ):
        self._choice, self._put, self._change = choice, put, change
        hint = "Shipped policies, and the runs in ./runs."
        runs = self._runs()
        self._run = gui.add_dropdown("policy", runs, initial_value=choice.run, order=0, hint=hint)
        self._checkpoint = gui.add_dropdown(
            "checkpoint", list(choice.files), initial_value=choice.checkpoint, order=1
        )
        self._run.on_update(self._run_chosen)
        self._checkpoint.on_update(self._checkpoint_chosen)

    def show(self, choice: Choice) -> None:
        """Show another choice."""
        self._choice = choice
        self._run.value = choice.run
        self._checkpoint.options = list(choice.files)
        self._checkpoint.value = choice.checkpoint

    def refresh(self) -> None:
        """Look for new runs."""
        runs = tuple(self._runs())
        if runs != self._run.options:
            self._run.options = runs

    def _runs(self) -> list[str]:
        runs = library.labels()
        return runs if self._choice.run in runs else [self._choice.run, *runs]

    async def _run_chosen(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            run = library.named(event.target.value)
            self._put(lambda: self._change(run, None))

    async def _checkpoint_chosen(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            name = event.target.value
            self._put(lambda: self._change(self._choice.run, name))
