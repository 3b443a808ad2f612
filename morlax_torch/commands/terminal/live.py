"""Phases of a command: moving lines on a terminal, a line at times on a file or pipe."""

from collections.abc import Callable
from contextlib import ExitStack
from threading import Event, Thread
from typing import Self

from rich.progress import BarColumn, Progress, ProgressColumn, Task, TimeElapsedColumn
from rich.text import Text

from ...host.phases import heard_by
from .cli import console

LONGEST_SILENCE = 30.0  # seconds without a line on a file or pipe


def described(name: str, share: float | None) -> str:
    return name if share is None else f"{name} {share:.0%}"


class Live:
    """Shows the phases of the work inside; on a file or pipe, after each LONGEST_SILENCE.

    Args:
        rows: lines that move; phases of this process are in the first one.
        describe: returns the text of a phase and its share.
    """

    def __init__(self, rows: int = 1, describe: Callable[[str, float | None], str] = described):
        self._words = _Words(describe)
        self._moving = Progress(
            *(BarColumn(bar_width=8), self._words, TimeElapsedColumn()),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        for _ in range(rows):
            self._moving.add_task("starting", total=None)
        self._told, self._over, self._open = Event(), Event(), ExitStack()

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
                    console.print(f"   {self._words.render(task)}")
            self._told.clear()

    def show(self, name: str, share: float | None = None, row: int = 0) -> None:
        task = self._moving.tasks[row]
        task.description, task.completed = name, share or 0.0
        task.total = None if share is None else 1.0

    def told(self) -> None:
        """Note that a line has been printed."""
        self._told.set()


class _Words(ProgressColumn):
    def __init__(self, describe: Callable[[str, float | None], str]):
        super().__init__()
        self._describe = describe

    def render(self, task: Task) -> Text:
        share = None if task.total is None else task.completed
        return Text(self._describe(task.description, share))
