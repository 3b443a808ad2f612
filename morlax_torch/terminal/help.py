"""Command lines whose help reads well in a narrow terminal."""

import inspect
import re
import shutil
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import tyro
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from tyro.constructors import (
    ConstructorRegistry,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

FIRST = (  # options that the help lists first
    *("env", "resume", "output", "config", "trials", "seconds", "minutes", "workers", "seed"),
    *("device", "worlds", "max_env_steps", "max_seconds"),
)
SHORT = len("morlax evaluate")  # of a command's name, to have its arguments on the same line
_registry = ConstructorRegistry()


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
    """Return the text of an option, if need be that of a class whose default `model` replaces."""
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
