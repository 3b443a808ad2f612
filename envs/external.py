"""Tasks from outside this package: a class in a Python file, or a package's entry point."""

import ast
import importlib.util
import inspect
import os
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType

from pydantic import ValidationError

from .bridges.gymnasium import GymnasiumWorlds
from .errors import MorlaxError, line_in, shortened, unknown, words
from .naming import GROUP, absolute
from .worlds.environment import Environment
from .worlds.interface import Worlds

MODELS = (".xml", ".mjcf", ".urdf")  # endings of files that MuJoCo loads


def from_file(name: str) -> type[Worlds]:
    """Import FILE.py once and return its CLASS.

    Raises:
        MorlaxError: the file or class is missing, the import fails, or the class is not a task.
    """
    file, _, member = absolute(name).rpartition(":")
    if name.endswith(".py"):
        raise MorlaxError(f"{name} is a file: name a class in it, such as {name}:MyRobot.")
    module = import_file(file, f"the task {member}")
    own = {key for key, value in vars(module).items() if _is_task(value)}
    if member not in own:
        raise unknown(f"task of {file}", member, own)
    return checked(getattr(module, member))


def from_entry_point(name: str) -> type[Worlds]:
    """Load the task that an installed package offers as `name`.

    Raises:
        MorlaxError: two packages offer it, the import fails, or the object is not a task.
    """
    points = metadata.entry_points(group=GROUP, name=name)
    values = sorted({point.value for point in points})
    if len(values) > 1:
        raise MorlaxError(
            f"several packages offer an environment called {name!r} ({', '.join(values)}): "
            "uninstall all but one."
        )
    try:
        found = next(iter(points)).load()
    except (Exception, SystemExit) as error:  # any error of the package's own code
        raise MorlaxError(
            f"the environment {name!r} cannot be imported from {values[0]}: {words(error)}"
        ) from None
    if not _is_task(found):
        raise MorlaxError(
            f"the environment {name!r} is {values[0]}, which is not a subclass of "
            "morlax_torch.envs.Worlds."
        )
    return checked(found)


def checked(task: type[Worlds]) -> type[Worlds]:
    """Return the class if it is complete.

    Raises:
        MorlaxError: it is no class of worlds, or abstract methods or default objectives are
            missing.
    """
    if not inspect.isclass(task) or not issubclass(task, Worlds):
        raise MorlaxError(f"{shortened(task)} is not a subclass of morlax_torch.envs.Worlds.")
    missing = sorted(getattr(task, "__abstractmethods__", ()))
    if task.resumable and task.state_dict is Worlds.state_dict:
        missing += ["state_dict and load_state_dict (or set resumable = False)"]
    if missing:
        raise MorlaxError(
            f"{task.__name__} does not define {', '.join(missing)}, which every task needs."
        )
    try:
        task.Options.model_validate({})
    except (AttributeError, ValidationError):
        raise MorlaxError(
            f"{task.__name__}.Options must be a subclass of ObjectiveOptions (TaskOptions for a "
            "robot) in which every option has a default, including objectives."
        ) from None
    return task


def import_file(file: str, what: str) -> ModuleType:
    """Import a Python file once, which should define `what` (for messages).

    Raises:
        MorlaxError: the file does not exist, or its import fails.
    """
    if not os.path.isfile(file):  # unlike Path.is_file, it never fails
        raise MorlaxError(f"there is no file {file}, which should define {what}.")
    return _run(file)


def parts_of(file: Path, *more: str) -> list[Path]:
    """Return a Python file and the existing files that its strings name, beside or below it.

    Of a model, also the files that it includes, its meshes and textures. `more`: other names.
    """
    try:
        nodes = list(ast.walk(ast.parse(file.read_bytes())))
    except (OSError, SyntaxError, ValueError):
        nodes = []
    names = [node.value for node in nodes if isinstance(node, ast.Constant)]
    found = {file: None}  # ordered
    for name in (*more, *names):
        if isinstance(name, str) and not os.path.isabs(name):
            path = os.path.normpath(os.path.join(file.parent, name))
            if os.path.isfile(path):  # unlike Path.is_file, it never fails
                found |= dict.fromkeys(_with_assets(Path(path)))
    return list(found)


def _with_assets(path: Path) -> list[Path]:
    """Return a file, and if it is a model, the files that it depends on."""
    if path.suffix.lower() not in MODELS:
        return [path]
    import mujoco

    try:
        listed = mujoco.mju_getXMLDependencies(str(path))
    except Exception:  # not a model; MuJoCo says so when it is loaded
        listed = []
    others = [Path(os.path.normpath(path.parent / name)) for name in listed]
    return [path, *(other for other in others if os.path.isfile(other))]


@cache
def _run(file: str) -> ModuleType:
    # Registered under its path, a name that no other module has; pydantic looks it up there.
    spec = importlib.util.spec_from_file_location(file, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # any error of the user's own code
        del sys.modules[file]
        line = line_in(error, file)
        place = f"{file}, line {line}," if line else file
        raise MorlaxError(f"{place} cannot be imported: {words(error)}") from None
    return module


def _is_task(value: object) -> bool:
    bases = (Worlds, Environment, GymnasiumWorlds)
    return inspect.isclass(value) and issubclass(value, Worlds) and value not in bases
