"""The command line of `train`: options over a file, a task's config or an earlier run."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import tyro
from pydantic import BaseModel, create_model

from .. import envs
from ..config import MAY_CHANGE, Config, config_class, differences, load_config
from ..config_files import algorithm_of, default_values, file_values, merged, task_values
from ..envs import MorlaxError
from ..envs.worlds.options import TaskOptions
from ..envs.worlds.section import Section
from ..torchrun import FIRST, MAY_RESTART, RESTARTS, launch
from . import cli

if TYPE_CHECKING:
    from ..runs.run import Run

PROGRAM = "python -m morlax_torch.train"
PLACES = {"cuda": "a GPU", "cpu": "the CPU"}
ABOUT = "Train one hypernetwork to hold a whole Pareto front of policies."


class Command(Section):
    config: Path | None = None
    """A YAML file of changes to the task's config."""
    output: Path | None = None
    """Folder of the run (None: runs/<task>/<time>-<seed>)."""
    resume: Path | None = None
    """Continue the run in this folder; only limits, evaluation, device and backend may change."""
    trust: bool = False
    """Let the resumed run import the FILE.py or module that its task names."""


class AnyTask(TaskOptions):
    objectives: dict[str, dict[str, float]] = {}
    """The objectives to trade off; each is a weighted sum of reward terms. Each task has its
    own."""


def read(arguments: Sequence[str]) -> "tuple[Config, Run | None, Path | None]":
    """Read the command line over the config of the file, task or run that it names."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name in ("--env", "--algorithm", "--config", "--resume", "--device", "--output"):
        first.add_argument(name)
    first.add_argument("--trust", action="store_true")
    early = first.parse_known_args(arguments)[0]
    for name in ("config", "output"):
        if early.resume and getattr(early, name):
            raise MorlaxError(
                f"--resume continues a run with its own config, in its own folder: "
                f"leave out --{name}."
            )
    if {"-h", "--help"} & set(arguments) and not (early.env or early.config or early.resume):
        _help_for_any_task(early.device)
    run = _run(Path(early.resume)) if early.resume else None
    if run and early.env:
        envs.get(early.env)  # the user names this code
    below = run.config(early.trust) if run else load_config(_values(early))
    model = create_model("Train", __base__=(Command, config_class(below.env, below.algorithm)))
    about = f"{ABOUT} The defaults below are those of --env {below.env}, from configs/."
    default = model.model_validate(below.model_dump())
    values = cli.parse(default, arguments, PROGRAM, about)
    own = {name: values.pop(name) for name in Command.model_fields}
    place = envs.resolve_device(values["device"])
    moved = run is not None and str(place) != below.device
    robot = issubclass(envs.get(below.env), envs.Environment)  # others have one simulator
    if robot and (values["backend"] is None or (moved and values["backend"] == below.backend)):
        values["backend"] = "warp" if place.type == "cuda" else "mujoco"
    config = load_config({**values, "device": str(place)})
    found = differences(below, config) if run else []
    if found:
        raise MorlaxError(
            f"a resumed run keeps its config ({'; '.join(found)}): leave that out, or start a new "
            f"run. Only {', '.join(MAY_CHANGE)} may change."
        )
    output = own["output"]
    if MAY_RESTART:
        if run is None and output is None:
            raise MorlaxError("torchrun --max-restarts needs --output FOLDER, to go on from there.")
        if RESTARTS and output is not None and _is_of_this_launch(output):
            return config, _run(output), None
    return config, run, output


def _is_of_this_launch(output: Path) -> bool:
    """Return whether the run was begun before `torchrun` restarted; only one process knows."""
    if not (output / "config.yaml").is_file():
        return False
    from ..runs import checkpoint

    known = checkpoint.load(output / "checkpoints" / "latest.pt").progress.launch
    return not FIRST or known == launch()


def _help_for_any_task(device: str | None) -> NoReturn:
    """Print the options that all robots have, and exit, without importing torch."""
    device_type = "cpu" if device == "cpu" else "cuda"
    values: dict[str, Any] = default_values(device_type)
    for name, field in Config.model_fields.items():
        kind = field.annotation
        if name in values and isinstance(kind, type) and issubclass(kind, BaseModel):
            values[name] = kind.model_validate(values[name])
    model = create_model("Train", __base__=(Command, Config), task=(AnyTask, AnyTask()))
    about = (
        f"{ABOUT} The defaults below are those of a new robot on {PLACES[device_type]}. Add "
        "--env NAME for the options and defaults of a task."
    )
    cli.parse(model.model_construct(env=tyro.MISSING, **values), ["--help"], PROGRAM, about)
    sys.exit(0)


def _run(folder: Path) -> "Run":
    from ..runs.run import Run  # imports torch

    return Run.open(folder)


def _values(early: argparse.Namespace) -> dict:
    own: dict[str, Any] = {} if early.algorithm is None else {"algorithm": early.algorithm}
    if early.config is None:
        if early.env is None:
            names = ", ".join(envs.names())
            raise MorlaxError(f"name a task: --env NAME, one of {names}, or FILE.py:CLASS.")
        envs.get(early.env)  # an unknown name is told before torch is imported
        device_type = envs.resolve_device(early.device).type
        return {**task_values(early.env, device_type, algorithm_of(own)), **own}
    device_type = envs.resolve_device(early.device).type
    values = file_values(Path(early.config), device_type)
    for name, given in (("env", early.env), ("algorithm", early.algorithm)):
        if given is not None and values.setdefault(name, given) != given:
            raise MorlaxError(
                f"{early.config} is for {name} {values[name]!r}, but --{name} says {given!r}."
            )
    if (early.env is None and early.algorithm is None) or not isinstance(values.get("env"), str):
        return values
    return merged(task_values(values["env"], device_type, algorithm_of(values)), values)
