"""Tasks from outside this package: a class in a file, or a package's entry point."""

import importlib.util
import inspect
import sys
import traceback
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType

from pydantic import ValidationError

from .environment import Environment
from .errors import MorlaxError, unknown
from .gymnasium_worlds import GymnasiumWorlds

GROUP = "morlax_torch.envs"

Task = type[Environment] | type[GymnasiumWorlds]


def is_file(name: str) -> bool:
    """Whether it is FILE.py:CLASS."""
    return name.rpartition(":")[0].endswith(".py") or name.endswith(".py")


def absolute(name: str) -> str:
    """FILE.py:CLASS with the whole path, so that it means the same everywhere; else the name."""
    file, colon, member = name.rpartition(":")
    return f"{Path(file).expanduser().resolve()}:{member}" if colon and is_file(name) else name


def title(name: str) -> str:
    """What to call a task in folders and pictures: of FILE.py:CLASS the class, else its name."""
    return name.rpartition(":")[2] if is_file(name) else name


def from_file(name: str) -> Task:
    """The class of FILE.py:CLASS, whose file is run once.

    Raises:
        MorlaxError: there is no such file or class, or it fails, or is no task.
    """
    file, _, member = absolute(name).rpartition(":")
    if name.endswith(".py"):
        raise MorlaxError(f"{name} is a file: say which class of it, such as {name}:MyRobot.")
    if not Path(file).is_file():
        raise MorlaxError(f"the task {member} was to be in {file}, but there is no such file.")
    module = _run(file)
    own = {key for key, value in vars(module).items() if _is_task(value)}
    if member not in own:
        raise unknown(f"task of {file}", member, own)
    return checked(getattr(module, member))


def offered() -> set[str]:
    """The names of installed packages' entry points. None of them is loaded."""
    return metadata.entry_points(group=GROUP).names


def from_entry_point(name: str) -> Task:
    """What an installed package offers as `name`.

    Raises:
        MorlaxError: two packages do, it cannot be imported, or is no task.
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
    except Exception as error:  # it is anyone's code
        raise MorlaxError(
            f"the environment {name!r} cannot be imported from {values[0]}: {_words(error)}"
        ) from None
    if not _is_task(found):
        raise MorlaxError(
            f"the environment {name!r} is {values[0]}, which is no class of "
            "morlax_torch.envs.Environment."
        )
    return checked(found)


def checked(task: Task) -> Task:
    """The class itself, if nothing is missing in it.

    Raises:
        MorlaxError: methods or default objectives are.
    """
    missing = sorted(getattr(task, "__abstractmethods__", ()))
    if missing:
        raise MorlaxError(f"{task.__name__} lacks what every task defines: {', '.join(missing)}.")
    try:
        task.Options.model_validate({})
    except (AttributeError, ValidationError):
        raise MorlaxError(
            f"{task.__name__}.Options must be a class of TaskOptions in which every option has a "
            "default, objectives too."
        ) from None
    return task


@cache
def _run(file: str) -> ModuleType:
    # Under its path, which is no other module's name; pydantic looks it up there.
    spec = importlib.util.spec_from_file_location(file, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # it is anyone's code
        del sys.modules[file]
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
        place = f"{file}, line {lines[-1]}," if lines else file
        raise MorlaxError(f"{place} cannot be imported: {_words(error)}") from None
    return module


def _is_task(value: object) -> bool:
    bases = (Environment, GymnasiumWorlds)
    return inspect.isclass(value) and issubclass(value, bases) and value not in bases


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
