"""Phases of a command: moving lines on a terminal, a line at times on a file or pipe."""

from contextlib import ExitStack
from threading import Event, Thread
from typing import Self

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ...host.phases import heard_by
from .cli import console

LONGEST_SILENCE = 30.0  # seconds without a line on a file or pipe


class Live:
    """Shows the phases of the work inside; on a file or pipe, after each LONGEST_SILENCE.

    Of the `rows` of moving lines, the first one shows the phases of this process.
    """

    def __init__(self, rows: int = 1):
        text = TextColumn("{task.description}", markup=False)
        self._moving = Progress(
            *(BarColumn(bar_width=8), text, TimeElapsedColumn()),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        for _ in range(rows):
            self._moving.add_task("starting", total=None)
        self._told, self._over, self._open = Event(), Event(), ExitStack()

    def describe(self, name: str, share: float | None) -> str:
        return name if share is None else f"{name} {share:.0%}"

    def __enter__(self) -> Self:
        self._open.enter_context(heard_by(self.show))
        self._open.enter_context(self._moving)
        if not console.is_terminal:
            Thread(target=self._tell, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
        self._over.set()
        self.told()

    def _tell(self) -> None:
        while not self._over.is_set():
            if not self._told.wait(LONGEST_SILENCE):
                for task in self._moving.tasks:
                    console.print(f"   {task.description}")
            self._told.clear()

    def show(self, name: str, share: float | None = None, row: int = 0) -> None:
        task = self._moving.tasks[row]
        task.description, task.completed = self.describe(name, share), share or 0.0
        task.total = None if share is None else 1.0

    def told(self) -> None:
        """Note that a line has been printed."""
        self._told.set()
