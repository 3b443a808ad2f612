"""The tasks by name, here and in Gymnasium's registry.

torch and the simulators are imported with the first task, not with this.
"""

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from .errors import MorlaxError, shortened, unknown
from .naming import GYMNASIUM, MJLAB, is_file, offered, trust
from .robots import TASKS

if TYPE_CHECKING:
    from .worlds.interface import Worlds

_LIBRARIES = {  # prefix of their names: what returns the class of a task
    GYMNASIUM: "bridges.gymnasium:from_id",
    MJLAB: "bridges.mjlab.worlds:from_task",
}
_REGISTRY: dict[str, "type[Worlds]"] = {}  # built-in tasks once they are used, and registered ones
NAMESPACE = "morlax_torch"  # of the tasks' ids in Gymnasium's registry


def register(name: str, task: "type[Worlds]") -> None:
    """Register `task` as `name` for `make`, every command and Gymnasium.

    Raises:
        MorlaxError: the name belongs to another class, or the class is incomplete.
    """
    former = _registered(name)
    if former is None:
        task = _imported("external:checked")(task)
        _announce(name)
        _REGISTRY[name] = task
    elif former is not task:
        raise MorlaxError(f"there is already an environment called {name!r}: choose another name.")


def names() -> tuple[str, ...]:
    """Return every registered name and every entry point of installed packages, unloaded."""
    return tuple(sorted({*TASKS, *_REGISTRY, *offered()}))


def get(name: str) -> "type[Worlds]":
    """Return the class of a task, by a name as for `make`; files may name it from now on.

    Raises:
        MorlaxError: there is no such task, or it cannot be loaded.
    """
    if not isinstance(name, str):
        raise MorlaxError(f"the name of a task must be a string, not {shortened(name)}.")
    trust(name)
    for prefix, home in _LIBRARIES.items():
        if name.startswith(prefix):
            return _imported(home)(name)
    if is_file(name):
        return _imported("external:from_file")(name)
    if _registered(name) is None and name in offered():
        register(name, _imported("external:from_entry_point")(name))
    if task := _registered(name):
        return task
    if name.lower().endswith((".xml", ".mjcf", ".urdf")):
        raise MorlaxError(
            f"{name} is a robot without a task: `morlax new {name}` writes a first draft of one, "
            "FILE.py:CLASS."
        )
    raise unknown("environment", name, names())


def _registered(name: str) -> "type[Worlds] | None":
    if name in TASKS and name not in _REGISTRY:
        _REGISTRY[name] = _imported(f"robots.{TASKS[name]}")
    return _REGISTRY.get(name)


def _imported(home: str) -> Any:
    module, _, member = home.partition(":")
    return getattr(import_module(f".{module}", __package__), member)


def _announce(name: str) -> None:
    """Register task `name` for `gymnasium.make`: "my_robot" becomes "morlax_torch/MyRobot-v0".

    Gymnasium's wrappers are disabled: the adapters check the order of calls themselves, and the
    passive checker would warn about every vector reward.
    """
    words = re.split(r"[\W_]+", name)
    identity = f"{NAMESPACE}/{''.join(word[:1].upper() + word[1:] for word in words)}-v0"
    former = gymnasium.registry.get(identity)
    if former is not None:
        if former.kwargs == {"task": name}:
            return  # after a module reload, Gymnasium would warn about a duplicate id
        raise MorlaxError(
            f"the environment {former.kwargs.get('task')!r} is {identity} in Gymnasium already, "
            f"and {name!r} would be too: choose another name."
        )
    gymnasium.register(
        identity,
        entry_point=f"{NAMESPACE}.adapters.gymnasium:GymnasiumEnv",
        vector_entry_point=f"{NAMESPACE}.adapters.gymnasium:GymnasiumVectorEnv",
        order_enforce=False,
        disable_env_checker=True,
        kwargs={"task": name},
    )


for _name in TASKS:
    _announce(_name)
