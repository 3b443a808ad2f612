"""Phases of long work, told to a listener: in commands, the terminal shows them."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar

Listener = Callable[[str, float | None], object]
_listener: ContextVar[Listener] = ContextVar("listener", default=lambda name, share: None)


def phase(name: str, share: float | None = None) -> None:
    """Tell what is done now, and which share of it is over, from 0 to 1; None: unknown.

    Other threads are not heard, and a GPU that runs behind is not waited for.
    """
    _listener.get()(name, share)


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Call `listener` with the name and share of each phase."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def within(name: str) -> AbstractContextManager[None]:
    """Put `name` before the phases inside: "trial 3: training"."""
    outer = _listener.get()
    return heard_by(lambda inner, share: outer(f"{name}: {inner}", share))
