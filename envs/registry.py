"""The tasks by name. torch and the simulators are imported with the first task, not with this."""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from .errors import MorlaxError, unknown
from .naming import GYMNASIUM, MJLAB, PLAYGROUND, is_file, offered, trust
from .robots import TASKS

if TYPE_CHECKING:
    from .worlds.interface import Worlds

_REGISTRY: dict[str, "type[Worlds]"] = {}  # built-in tasks once they are used, and registered ones
_LISTENERS: list[Callable[[str], None]] = []  # called with the name of each task


def register(name: str, task: "type[Worlds]") -> None:
    """Register `task` as `name` for `make`, every command and Gymnasium.

    Raises:
        MorlaxError: the name or its Gymnasium id belongs to another class, or the class is
            incomplete.
    """
    from .external import checked

    known = _known(name)
    if known is None:
        task = checked(task)
        for announce in _LISTENERS:
            announce(name)
        _REGISTRY[name] = task
    elif known is not task:
        raise MorlaxError(f"there is already an environment called {name!r}: choose another name.")


def announce_to(listener: Callable[[str], None]) -> None:
    """Call `listener` with the name of each built-in task now, and of later ones on `register`."""
    for name in TASKS:
        listener(name)
    _LISTENERS.append(listener)


def names() -> tuple[str, ...]:
    """Return every registered name and every entry point of installed packages, unloaded."""
    return tuple(sorted({*TASKS, *_REGISTRY, *offered()}))


def get(name: str) -> "type[Worlds]":
    """Return the class registered as `name`.

    It can also be that of "FILE.py:CLASS", "gymnasium:ID", "mjlab:TASK" or "playground:TASK".

    The code of such a class runs, and files may name it from now on (see `trust`).

    Raises:
        MorlaxError: there is no such task, or it cannot be loaded.
    """
    trust(name)
    if name.startswith(GYMNASIUM):
        from .worlds.gymnasium import from_id

        return from_id(name)
    if name.startswith(MJLAB):
        from .worlds.mjlab import from_task

        return from_task(name)
    if name.startswith(PLAYGROUND):
        from .worlds.playground import from_task

        return from_task(name)
    if is_file(name):
        from .external import from_file

        return from_file(name)
    known = _known(name)
    if known is not None:
        return known
    if name not in offered():
        raise unknown("environment", name, names())
    from .external import from_entry_point

    task = from_entry_point(name)
    register(name, task)
    return task


def _known(name: str) -> "type[Worlds] | None":
    """Return a registered class, or a built-in one, whose module is imported only now."""
    if name in TASKS and name not in _REGISTRY:
        module, _, member = TASKS[name].partition(":")
        robots = f"{__package__}.robots"
        _REGISTRY[name] = getattr(import_module(f"{robots}.{module}"), member)
    return _REGISTRY.get(name)
