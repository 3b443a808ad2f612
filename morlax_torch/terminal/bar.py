"""A bar for work whose end is known."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from .cli import console


@contextmanager
def bar(label: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal, and nothing on a file or pipe.

    Yields a function to be called with the share that is done, in [0, 1].
    """
    shown = Progress(
        TextColumn(label),
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = shown.add_task(label, total=1.0)
    with shown:
        yield lambda share: shown.update(task, completed=share)
