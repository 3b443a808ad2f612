"""Command lines: options of commands, and of configs over a file, a task or an earlier run."""

import math
import re
import shutil
import sys
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_origin

import tyro
from pydantic import BaseModel, Field
from pydantic_core import PydanticUndefined
from rich.table import Column, Table
from tyro import constructors

from ... import envs
from ...configuration.config import DRAFT, Config, check_resumable, load_config
from ...configuration.files import file_values, read_yaml, task_values
from ...envs.errors import MorlaxError, validated
from ...envs.naming import absolute, is_file
from ...envs.worlds.options import Section
from ...host.torchrun import FIRST, MAY_RESTART, launch
from .cli import console
from .process import program, typed

if TYPE_CHECKING:
    from ...runs.run import Run

HELP_ALL = "--help-all"
USUAL = "cheetah"  # the task whose options --help-all lists if the command line names none
KINDS = re.compile(r"\b(int|float|Path)\b")  # of values, in the short help

C = TypeVar("C", bound=Section)
_registry = constructors.ConstructorRegistry()

Device = Annotated[
    str | None,
    Field(description="Device of the worlds: cuda, cpu, ... (None: CUDA if there is a GPU)."),
]
Texts = tyro.conf.UseAppendAction[tuple[str, ...]]  # an option once per text
Positional, arg = tyro.conf.Positional, tyro.conf.arg


class Trusting(Section):
    """Options of commands that open runs."""

    trust: bool = False
    """Let the run import the Python files and modules that it names."""
    env: Annotated[str | None, arg(metavar="FOLDER/FILE.py:CLASS")] = None
    """Your own task, if its file has moved or is to be used as edited; it is trusted (None: the
    task as it was when the run began)."""


class OfRun(Trusting):
    run: Annotated[str, Positional, arg(metavar="RUN")]
    """Run folder (its best checkpoint), or runs/TASK or latest for the newest run; checkpoint file;
    or shipped policy."""

    def use(self, command: str, *words: str) -> str:
        """Return the command line that uses the run."""
        moved = [] if self.env is None else ["--env", self.env]
        return typed(command, self.run, *["--trust"] * self.trust, *moved, *words)


class Limits(Section):
    """Options of commands that keep requirements."""

    at_least: Annotated[Texts, arg(metavar="run=2000")] = ()
    """Least value of an objective or quantity, once per requirement."""
    at_most: Annotated[Texts, arg(metavar="power=60")] = ()
    """Largest value of an objective or quantity, once per requirement."""

    def limits(self) -> tuple[dict[str, float], dict[str, float]]:
        """Return the least and the largest values by name, the strictest of each.

        "run=500 @ 3-5" is named "run @ 3-5".
        """
        least = numbers(self.at_least, "--at-least run=2000")
        most = numbers(self.at_most, "--at-most power=60")
        level = itemgetter(1)  # the last one of a name counts
        return dict(sorted(least, key=level)), dict(sorted(most, key=level, reverse=True))


def numbers(texts: Sequence[str], example: str) -> list[tuple[str, float]]:
    """Read names and numbers, such as "thigh=0.4"; a refusal shows the example."""
    rows = []
    for text in texts:
        name, _, level = (part.strip() for part in text.partition("="))
        level, at, window = (part.strip() for part in level.partition("@"))
        try:
            number = float(level) if name else math.nan
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise MorlaxError(f"{text!r} names no number: write for example {example}.")
        rows.append((f"{name} @ {window}" if at else name, number))
    return rows


@_registry.struct_rule
def _plain_values(info: constructors.StructTypeInfo) -> constructors.StructConstructorSpec | None:
    """Make tyro read a pydantic model as plain values, which are then checked together."""
    # tyro's own rule checks each section by itself, so that an error does not say where its value
    # stands, and searches the source code of models for comments, which takes 0.2 s
    if not (isinstance(info.type, type) and issubclass(info.type, BaseModel)):
        return None
    fields = []
    for name, field in info.type.model_fields.items():
        default = getattr(info.default, name, field.default)
        if default is PydanticUndefined:
            default = tyro.MISSING
        kind: Any = field.rebuild_annotation()
        if default is None or default == {}:  # texts say what that means
            kind = Annotated[kind, arg(help_behavior_hint="")]
        fields.append(constructors.StructFieldSpec(name, kind, default, text_of(info.type, name)))
    if issubclass(info.type, Trusting):
        fields.sort(key=lambda field: field.name in Trusting.model_fields)
    return constructors.StructConstructorSpec(dict, tuple(fields))


def text_of(model: type[BaseModel], option: str) -> str:
    """Return an option's help text, inherited if only its default changed."""
    for ancestor in model.__mro__:
        field = ancestor.model_fields.get(option) if issubclass(ancestor, BaseModel) else None
        if field is not None and field.description:
            return " ".join(field.description.split())
    return ""


def parse(command: type[C], arguments: Sequence[str]) -> C:
    """Read the options of a command, whose class has its name, and whose docstring is its help."""
    text, config = _paragraphs(command.__doc__ or ""), (tyro.conf.FlagCreatePairsOff,)
    return validated(command, _typed(command, command, arguments, description=text, config=config))


def _typed(
    command: type[BaseModel], options: type[BaseModel], arguments: Sequence[str], **settings: Any
) -> Any:
    prog = program(command.__name__.lower())
    return tyro.cli(options, prog=prog, args=arguments, registry=_registry, **settings)


def _paragraphs(text: str) -> str:
    """Return paragraphs that fit the terminal, indented, because tyro would join other lines."""
    width, parts = shutil.get_terminal_size().columns, text.split("\n\n")
    wrapper = TextWrapper(width, "  ", "  ", break_on_hyphens=False)
    return "\n\n".join(wrapper.fill(" ".join(part.split())) for part in parts)


# The command that trains


SHOWN = {  # names of options in the short help, by heading
    "What to learn": ("env", "algorithm", "scalarization", "config", "start_from"),
    "The run": ("output", "resume", "trust", "seed", "device", "explore"),
    "When to stop": ("max_env_steps", "max_seconds", "decay_fraction"),
    "Sizes": ("worlds", "horizon", "sampling.clusters", "network.actor", "ppo.learning_rate"),
    "Evaluations": ("evaluation.every", "evaluation.tradeoffs"),
}
EXAMPLES = (
    "--env cheetah",
    "--env hopper --seed 1 --output runs/mine",
    "--env my_robot.py:Robot --worlds 512",
    "--resume latest --max-env-steps 400_000_000",
)


class Train(Section):
    """Train one hypernetwork to hold a whole Pareto front of policies."""

    # these decide which others there are
    env: str | None = None
    algorithm: str | None = None
    device: str | None = None
    config: Path | None = None
    """A YAML file of changes to the task's config."""
    output: Path | None = None
    """Folder of the run (None: runs/<task>/<time>-<seed>)."""
    resume: Path | None = None
    """Continue the run in this folder, or in the newest (runs/TASK or latest); only limits,
    evaluation, device and backend may change. On a CPU and with a limit in steps, the result equals
    that of an uninterrupted run bit for bit."""
    trust: bool = False
    """Let the resumed run import the Python files and modules that it names."""
    explore: bool = False
    """Show the robot and the growing front in the browser, as `morlax explore` does."""


def print_help() -> None:
    """Print the options of `train` that people use, under their headings, and examples."""
    start = program("train")
    console.print(f"usage: {start} [OPTIONS]\n\n{_paragraphs(Train.__doc__ or '')}")
    for heading, names in SHOWN.items():
        table = Table.grid(Column(min_width=30, no_wrap=True), "")
        for name in names:
            table.add_row(*_help_row(name))
        console.print(f"\n{heading}:", table, sep="\n")
    console.print("\nExamples:")
    for example in EXAMPLES:
        console.print(f"  {start} {example}")
    console.print(f"\nTasks: {', '.join(envs.names())}.", soft_wrap=False)
    console.print(f"\nAll options, and the defaults of a task:\n  {start} --env NAME {HELP_ALL}")


def _help_row(name: str) -> tuple[str, str]:
    """Return an option with the kind of its value, and the first sentence of its text."""
    model: Any = Train if name in Train.model_fields else Config
    *sections, option = name.split(".")
    for section in sections:
        model = model.model_fields[section].annotation
    kind = model.model_fields[option].annotation
    numeric = KINDS.search(str(kind))
    value = "" if kind is bool else numeric[0].upper() if numeric else "NAME"
    label = f"  --{name.replace('_', '-')} {value}" + " ..." * (get_origin(kind) is tuple)
    text = text_of(model, option) or text_of(Config, option)
    first, *_ = re.split(r"(?<=\.) (?=[A-Z])", text, maxsplit=1)
    return label, first


def _base_values(start: Train) -> dict[str, Any]:
    """Return the values of the file or task that a command line names."""
    if start.env is not None:
        envs.get(start.env)  # an unknown name is told before torch is imported
    elif start.config is None:
        names = ", ".join(envs.names())
        raise MorlaxError(f"name a task: --env NAME, one of {names}, or FILE.py:CLASS.")
    device_type = envs.resolve_device(start.device).type
    if start.config is None:
        values = task_values(str(start.env), device_type, start.algorithm or "morlax")
    else:
        for kind in ("cpu", "cuda"):  # also what only another machine would use
            load_config(file_values(start.config, kind, start.env, start.algorithm, True), DRAFT)
        values = file_values(start.config, device_type, start.env, start.algorithm)
        env = read_yaml(start.config).get("env")
        if start.env and isinstance(env, str) and absolute(env) != absolute(start.env):
            console.print(f"{start.config} is for {env}: its values are used for {start.env}")
    return values | start.model_dump(include={"device"}, exclude_none=True)


def values_over(start: Train, others: Sequence[str], base: Config | None = None) -> dict[str, Any]:
    """Return the plain values of a config (None: that of the command line), and options over it."""
    base = base or load_config(_base_values(start), DRAFT)  # which the options may repair
    text = f"All options of a config, with the defaults of --env {base.env}, from configs/."
    words = ["--help" if word == HELP_ALL else word for word in others]
    helps = HELP_ALL in others
    settings: Any = {"default": base, "description": text, "add_help": helps}
    try:
        return _typed(Train, type(base), words, **settings)
    except SystemExit as error:
        if error.code == 2 and not helps:  # not where a signal ends the command
            print(f"All options: {program('train')} --env NAME {HELP_ALL}", file=sys.stderr)
        raise


def placed(values: dict[str, Any], resumed: Config | None = None) -> Config:
    """Return the config of these values, with the device resolved and a simulator for it.

    A run to resume, whose config is `resumed`, may move to another device.
    """
    device, backend = envs.resolve_device(values["device"]), values["backend"]
    if resumed is not None and str(device) != resumed.device and backend == resumed.backend:
        backend = None
    robot = issubclass(envs.get(values["env"]), envs.Environment)  # others have one simulator
    if robot and backend is None:
        values["backend"] = "warp" if device.type == "cuda" else "mujoco"
    return load_config({**values, "device": str(device)})


def read(arguments: Sequence[str]) -> "tuple[Config, Run | None, Train]":
    """Read the command line of `train`: its config, the run to resume, and other options."""
    if {"-h", "--help"} & set(arguments):
        print_help()
        sys.exit(0)
    settings: Any = {"default": Train(), "add_help": False, "return_unknown_args": True}
    values, others = _typed(Train, Train, arguments, **settings)
    start = validated(Train, values)
    if HELP_ALL in others and not (start.env or start.config or start.resume):
        start = start.model_copy(update={"env": USUAL})
    if start.resume is not None:
        return *_resumed(start, others), start
    config = placed(values_over(start, others))
    if MAY_RESTART and start.output is None:
        raise MorlaxError("torchrun --max-restarts needs --output FOLDER, to go on from there.")
    if MAY_RESTART and start.output and (start.output / "config.yaml").is_file():
        from ...runs import checkpoint
        from ...runs.run import Run, taken

        latest = start.output / "checkpoints" / "latest.pt"
        if FIRST and checkpoint.load(latest).progress.launch != launch():  # another launch began it
            raise taken(start.output)
        return config, Run.open(start.output), start
    return config, None, start


def _resumed(start: Train, options: Sequence[str]) -> "tuple[Config, Run]":
    from ...runs.run import Run  # imports torch

    for name in start.model_dump(include={"config", "output"}, exclude_none=True):
        raise MorlaxError(
            f"--resume continues a run with its own config, in its own folder: leave out --{name}."
        )
    assert start.resume is not None
    run = Run.open(start.resume)
    if start.env:
        envs.get(start.env)  # the user names this code
    moved = start.env if start.env and is_file(start.env) else None
    base = run.config(start.trust, moved)
    mistake, remedy = "a resumed run keeps its config", "leave that out, or start a new run"
    if start.algorithm not in (None, base.algorithm):  # whose options may not fit this config
        change = f"algorithm: {start.algorithm} instead of {base.algorithm}"
        raise MorlaxError(f"{mistake} ({change}): {remedy}.")
    values = values_over(start, options, base)
    values |= start.model_dump(include={"device", "env"}, exclude_none=True)
    config = placed(values, base)
    check_resumable(base, config, mistake, remedy)
    return config, run
