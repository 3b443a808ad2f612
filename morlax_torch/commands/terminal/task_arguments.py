"""The command line of commands that train: options over a file or a config, and their help."""

import argparse
import inspect
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import tyro
from pydantic import BaseModel, Field, create_model
from pydantic_core import PydanticUndefined
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from ... import envs
from ...configuration.config import (
    DRAFT,
    Config,
    config_class,
    load_config,
)
from ...configuration.files import (
    algorithm_of,
    default_values,
    file_values,
    read_yaml,
    task_values,
)
from ...envs import MorlaxError
from ...envs.naming import absolute
from ...envs.worlds.options import Section, TaskOptions
from .cli import console

FIRST = (  # options that the help lists first
    *("env", "resume", "output", "config", "trials", "seconds", "minutes", "workers", "seed"),
    *("device", "worlds", "max_env_steps", "max_seconds"),
)
SHORT = len("morlax evaluate")  # of a command's name, to have its arguments on the same line
_registry = ConstructorRegistry()

# arguments of several commands
RunName = Annotated[
    str,
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="RUN",
        help="Run folder (its best checkpoint), or runs/TASK or latest for the newest run; "
        "checkpoint file; or shipped policy.",
    ),
]
_TRUST = "Let the run import the Python files and modules that it names."
_MOVED = (
    "Your own task, if its file has moved or is to be used as edited; it is trusted (None: the "
    "task as it was when the run began)."
)
_DEVICE = "Device that runs the worlds: cuda, cpu, ... (None: CUDA if there is a GPU)."
_PORT = "TCP port to listen on, or the next free one; 0 selects any."
_HOST = "Address to listen on; 0.0.0.0 accepts connections from the whole network."
Trust = Annotated[bool, tyro.conf.arg(help=_TRUST)]
Moved = Annotated[str | None, tyro.conf.arg(metavar="FOLDER/FILE.py:CLASS", help=_MOVED)]
Device = Annotated[str | None, tyro.conf.arg(help=_DEVICE)]
Host = Annotated[str, tyro.conf.arg(metavar="ADDRESS", help=_HOST)]
Port = Annotated[int, tyro.conf.arg(metavar="NUMBER", help=_PORT)]

PLACES = {"cuda": "a GPU", "cpu": "the CPU"}


@_registry.struct_rule
def _plain_values(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Make tyro read a pydantic model as plain values, which `load_config` then checks."""
    if not (isinstance(info.type, type) and issubclass(info.type, BaseModel)):
        return None
    fields = []
    for name, field in info.type.model_fields.items():
        default = getattr(info.default, name, field.default)
        if default is PydanticUndefined:
            default = tyro.MISSING
        kind: Any = field.annotation
        fields.append(StructFieldSpec(name, kind, default, text_of(info.type, name)))
    fields.sort(key=lambda field: FIRST.index(field.name) if field.name in FIRST else len(FIRST))
    return StructConstructorSpec(dict, tuple(fields))


def text_of(model: type[BaseModel], option: str) -> str:
    """Return an option's help text, inherited if only its default changed."""
    for ancestor in model.__mro__:
        field = ancestor.model_fields.get(option) if issubclass(ancestor, BaseModel) else None
        if field is not None and field.description:
            return " ".join(field.description.split())
    return ""


def parse(default: BaseModel, arguments: Sequence[str], prog: str, about: str) -> Any:
    """Parse the command line over `default`, into nested plain values."""
    return tyro.cli(
        type(default),
        prog=prog,
        default=default,
        args=arguments,
        description=_wrapped(about),
        registry=_registry,
    )


def call(function: Callable[..., None], arguments: Sequence[str], prog: str) -> None:
    """Call a function with the arguments of a command line; its docstring is the help."""
    about, _, options = inspect.cleandoc(function.__doc__ or "").partition("\nArgs:\n")
    about = "\n\n".join(map(_wrapped, about.split("\n\n")))
    options = re.sub(r"\n {8,}", " ", options)  # tyro would keep these line breaks
    function.__doc__ = f"{about}\n\nArgs:\n{options}"
    config = (tyro.conf.FlagCreatePairsOff,)
    if len(prog) > SHORT:
        prog += "\n  "
    tyro.cli(function, args=arguments, prog=prog, description=about, config=config)


def _wrapped(paragraph: str) -> str:
    # tyro joins lines unless they begin with a space
    width = shutil.get_terminal_size().columns
    words = " ".join(paragraph.split())
    return textwrap.fill(words, width, initial_indent="  ", subsequent_indent="  ")


class AnyTask(TaskOptions):
    objectives: dict[str, dict[str, float]] = {}
    """The objectives to trade off; each is a weighted sum of reward terms. Each task has its
    own."""


class CommandLine:
    """The command line of a command that has options of its own beside those of a config."""

    def __init__(self, program: str, about: str, options: type[Section]):
        self._program, self._about, self._options = program, about, options

    def early(self, arguments: Sequence[str], *more: str) -> argparse.Namespace:
        """Read the options that decide which others exist, and those named in `more`."""
        first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
        for name in ("--env", "--algorithm", "--config", "--device", *more):
            first.add_argument(name)
        return first.parse_known_args(arguments)[0]

    def parse(self, arguments: Sequence[str], below: Config) -> tuple[dict, dict[str, Any]]:
        """Parse the command line over `below`: the command's own options, and a config's values.

        Options may repair a base whose values do not fit together.
        """
        kind = config_class(below.env, below.algorithm)
        model = create_model("Command", __base__=(self._options, kind), env=_env())
        about = f"{self._about} The defaults below are those of --env {below.env}, from configs/."
        default = model.model_validate(below.model_dump(), context=DRAFT)
        values = parse(default, arguments, self._program, about)
        return {name: values.pop(name) for name in self._options.model_fields}, values

    def help_for_any_task(self, device: str | None) -> NoReturn:
        """Print the options that all robots have, and exit, without importing torch."""
        device_type = "cpu" if device == "cpu" else "cuda"
        values: dict[str, Any] = default_values(device_type)
        for name, field in Config.model_fields.items():
            kind = field.annotation
            if name in values and isinstance(kind, type) and issubclass(kind, BaseModel):
                values[name] = kind.model_validate(values[name])
        bases = self._options, Config
        task: Any = (AnyTask, AnyTask())
        model = create_model("Command", __base__=bases, env=_env(), task=task)
        about = (
            f"{self._about} The defaults below are those of a new robot on "
            f"{PLACES[device_type]}. Add --env NAME for the options and defaults of a task."
        )
        default = model.model_construct(env=tyro.MISSING, **values)
        parse(default, ["--help"], self._program, about)
        sys.exit(0)


def _env() -> Any:
    """Return the field of the task, which names all of them."""
    about = (
        f"The task: {', '.join(envs.names())}, mjlab:TASK, playground:TASK, FILE.py:CLASS for your "
        "own, or gymnasium:ID for a Gymnasium environment with a vector reward (docs/tasks.md)."
    )
    return str, Field(description=about)


def asks_for_help(arguments: Sequence[str]) -> bool:
    return bool({"-h", "--help"} & set(arguments))


def placed(values: dict[str, Any], resumed: Config | None = None) -> Config:
    """Return the config of these values, with the device resolved and a simulator for it.

    A run to resume, whose config is `resumed`, may move to another device.
    """
    place = envs.resolve_device(values["device"])
    moved = resumed is not None and str(place) != resumed.device
    robot = issubclass(envs.get(values["env"]), envs.Environment)  # others have one simulator
    kept = resumed is not None and moved and values["backend"] == resumed.backend
    if robot and (values["backend"] is None or kept):
        values["backend"] = "warp" if place.type == "cuda" else "mujoco"
    return load_config({**values, "device": str(place)})


def draft(early: argparse.Namespace) -> Config:
    """Return the config of the file or task that the command line names, which it may repair."""
    return load_config(_base_values(early), DRAFT)


def _base_values(early: argparse.Namespace) -> dict[str, Any]:
    own: dict[str, Any] = {} if early.algorithm is None else {"algorithm": early.algorithm}
    if early.config is None:
        if early.env is None:
            names = ", ".join(envs.names())
            raise MorlaxError(f"name a task: --env NAME, one of {names}, or FILE.py:CLASS.")
        envs.get(early.env)  # an unknown name is told before torch is imported
        device_type = envs.resolve_device(early.device).type
        return {**task_values(early.env, device_type, algorithm_of(own)), **own}
    place, path = envs.resolve_device(early.device), Path(early.config)
    values = file_values(path, place.type, early.env, early.algorithm)
    named = read_yaml(path).get("env")
    if early.env and isinstance(named, str) and absolute(named) != absolute(early.env):
        console.print(f"{path} is for {named}: its values are used for {early.env}")
    return values
