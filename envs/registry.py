"""The tasks by name. torch and the simulators are imported with the first task, not with this."""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .errors import MorlaxError, unknown
from .naming import GYMNASIUM, MJLAB, PLAYGROUND, check_name, is_file, offered, trust
from .robots import TASKS

if TYPE_CHECKING:
    from .worlds.interface import Worlds

_LIBRARIES = {  # prefix of their names: what returns the class of a task
    GYMNASIUM: "bridges.gymnasium:from_id",
    MJLAB: "bridges.mjlab.worlds:from_task",
    PLAYGROUND: "bridges.playground:from_task",
}
_REGISTRY: dict[str, "type[Worlds]"] = {}  # built-in tasks once they are used, and registered ones
_LISTENERS: list[Callable[[str], None]] = []  # called with the name of each task


def register(name: str, task: "type[Worlds]") -> None:
    """Register `task` as `name` for `make`, every command and Gymnasium.

    Raises:
        MorlaxError: the name belongs to another class, or the class is incomplete.
    """
    from .external import checked

    check_name(name)
    former = _registered(name)
    if former is None:
        task = checked(task)
        for announce in _LISTENERS:
            announce(name)
        _REGISTRY[name] = task
    elif former is not task:
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
    """Return the class registered as `name`, "FILE.py:CLASS", "gymnasium:ID" or "mjlab:TASK".

    Also "playground:TASK". Its code runs, and files may name it from now on (see `trust`).

    Raises:
        MorlaxError: there is no such task, or it cannot be loaded.
    """
    check_name(name)
    trust(name)
    for prefix, home in _LIBRARIES.items():
        if name.startswith(prefix):
            return _imported(home)(name)
    if is_file(name):
        from .external import from_file

        return from_file(name)
    task = _registered(name)
    if task is None and name in offered():
        from .external import from_entry_point

        task = from_entry_point(name)
        register(name, task)
    if task is None:
        raise unknown("environment", name, names())
    return task


def _registered(name: str) -> "type[Worlds] | None":
    if name in TASKS and name not in _REGISTRY:
        _REGISTRY[name] = _imported(f"robots.{TASKS[name]}")
    return _REGISTRY.get(name)


def _imported(home: str) -> Any:
    module, _, member = home.partition(":")
    return getattr(import_module(f".{module}", __package__), member)
