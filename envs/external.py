"""Tasks from outside this package: a class in a Python file, or a package's entry point."""

import ast
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import mujoco

from .bridges.gymnasium import GymnasiumWorlds
from .errors import MorlaxError, shortened, unknown, user_code, validated
from .naming import GROUP, absolute
from .worlds.environment import Environment
from .worlds.interface import Worlds
from .worlds.options import ObjectiveOptions, TaskOptions

DRAWING = ("begin", "prepare_starts", "vary_model")  # methods in which tasks draw at random
MODELS = (".xml", ".mjcf", ".urdf")  # endings of files that MuJoCo loads


def from_file(name: str) -> type[Worlds]:
    """Import FILE.py once and return its CLASS."""
    file, _, member = absolute(name).rpartition(":")
    if name.endswith(".py"):
        raise MorlaxError(f"{name} is a file: name a class in it, such as {name}:MyRobot.")
    members = vars(import_file(file, f"the task {member}"))
    if not _is_task(members.get(member)):
        tasks = [key for key, value in members.items() if _is_task(value)]
        raise unknown(f"task of {file}", member, tasks)
    return checked(members[member])


def from_entry_point(name: str) -> type[Worlds]:
    """Load the task that an installed package offers as `name`."""
    point, *_ = metadata.entry_points(group=GROUP, name=name)
    with user_code(f"the environment {name!r} cannot be imported from {point.value}"):
        return checked(point.load())


def checked(task: type[Worlds]) -> type[Worlds]:
    """Return the class, or raise MorlaxError unless it is a complete class of worlds."""
    if not inspect.isclass(task) or not issubclass(task, Worlds):
        raise MorlaxError(f"{shortened(task)} is not a subclass of morlax_torch.envs.Worlds.")
    missing = sorted(getattr(task, "__abstractmethods__", ()))
    if task.resumable and task.state_dict is Worlds.state_dict:
        missing += ["state_dict and load_state_dict (or set resumable = False)"]
    if missing:
        raise MorlaxError(
            f"{task.__name__} does not define {', '.join(missing)}, which every task needs."
        )
    kind = TaskOptions if issubclass(task, Environment) else ObjectiveOptions
    options = getattr(task, "Options", None)
    if not inspect.isclass(options) or not issubclass(options, kind):
        raise MorlaxError(f"{task.__name__}.Options must be a subclass of {kind.__name__}.")
    validated(options, {}, f"every option of {task.__name__}.Options needs a valid default: ")
    drawing = any(getattr(task, name, None) is not getattr(Environment, name) for name in DRAWING)
    base: Any = task.Options
    if drawing and base.varies is TaskOptions.varies:

        class Options(base):  # episodes may differ without reset noise
            varies: ClassVar[bool] = True

        task.Options = Options
    return task


def import_file(file: str, what: str) -> ModuleType:
    """Import a Python file once, which should define `what` (for messages)."""
    if file in sys.modules:
        return sys.modules[file]
    if not os.path.isfile(file):  # unlike Path.is_file, it never fails
        raise MorlaxError(f"there is no file {file}, which should define {what}.")
    # Registered under its path, a name that no other module has; pydantic looks it up there.
    spec = importlib.util.spec_from_file_location(file, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file] = module
    try:
        with user_code(f"{file} cannot be imported", file):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[file]
        raise
    return module


def parts_of(file: Path, *more: str) -> list[Path]:
    """Return a Python file and the existing files that its strings name, beside or below it.

    Of a model, also the files that it includes, its meshes and textures. `more`: other names.
    """
    try:
        nodes = list(ast.walk(ast.parse(file.read_bytes())))
    except (OSError, SyntaxError, ValueError):
        nodes = []
    names = [*more, *(node.value for node in nodes if isinstance(node, ast.Constant))]
    parts = {file: None}  # ordered
    for name in names:
        if not isinstance(name, str) or name.startswith(os.sep):
            continue
        path = os.path.join(file.parent, name)
        assets: Iterable[str] = ()
        if path.lower().endswith(MODELS) and os.path.isfile(path):
            with suppress(Exception):  # not a model; MuJoCo says so when it is loaded
                assets = mujoco.mju_getXMLDependencies(path)
                spec = mujoco.MjSpec.from_file(path)  # for a URDF and height fields
                named = [*spec.meshes, *spec.hfields]
                assets = [*assets, *(os.path.join(spec.meshdir, x.file) for x in named)]
        for part in (path, *(os.path.join(os.path.dirname(path), asset) for asset in assets)):
            if os.path.isfile(part):  # unlike Path.is_file, it never fails
                parts[Path(os.path.normpath(part))] = None
    return list(parts)


def _is_task(value: object) -> bool:
    bases = (Worlds, Environment, GymnasiumWorlds)
    return inspect.isclass(value) and issubclass(value, Worlds) and value not in bases
