"""The command line of `train`: options over a file, a task's config or an earlier run."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from pydantic import create_model

from .. import envs
from ..config import MAY_CHANGE, Config, config_class, differences, load_config
from ..config_files import file_values, merged, task_values
from ..envs import MorlaxError
from ..envs.worlds.section import Section
from ..runs.run import Run
from . import cli

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


def read(arguments: Sequence[str]) -> tuple[Config, Run | None, Path | None]:
    """Read the command line over the config of the file, task or run that it names."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name in ("--env", "--config", "--resume", "--device", "--output"):
        first.add_argument(name)
    first.add_argument("--trust", action="store_true")
    early = first.parse_known_args(arguments)[0]
    for name in ("config", "output"):
        if early.resume and getattr(early, name):
            raise MorlaxError(
                f"--resume continues a run with its own config, in its own folder: "
                f"leave out --{name}."
            )
    run = Run.open(Path(early.resume)) if early.resume else None
    if run and early.env:
        envs.get(early.env)  # the user names this code
    below = run.config(early.trust) if run else load_config(_values(early, arguments))
    model = create_model("Train", __base__=(Command, config_class(below.env)))
    about = f"{ABOUT} The defaults below are those of --env {below.env}, from configs/."
    default = model.model_validate(below.model_dump())
    values = cli.parse(default, arguments, "python -m morlax_torch.train", about)
    own = {name: values.pop(name) for name in Command.model_fields}
    place = envs.resolve_device(values["device"])
    moved = run is not None and str(place) != below.device
    if values["backend"] is None or (moved and values["backend"] == below.backend):
        values["backend"] = "warp" if place.type == "cuda" else "mujoco"
    config = load_config({**values, "device": str(place)})
    found = differences(below, config) if run else []
    if found:
        raise MorlaxError(
            f"a resumed run keeps its config ({'; '.join(found)}): leave that out, or start a new "
            f"run. Only {', '.join(MAY_CHANGE)} may change."
        )
    return config, run, own["output"]


def _values(early: argparse.Namespace, arguments: Sequence[str]) -> dict:
    device_type = envs.resolve_device(early.device).type
    if early.config is None:
        if early.env is None and not {"-h", "--help"} & set(arguments):
            names = ", ".join(envs.names())
            raise MorlaxError(f"name a task: --env NAME, one of {names}, or FILE.py:CLASS.")
        return task_values(early.env or "cheetah", device_type)
    values = file_values(Path(early.config), device_type)
    if early.env is None:
        return values
    if values.setdefault("env", early.env) != early.env:
        raise MorlaxError(
            f"{early.config} is for env {values['env']!r}, but --env says {early.env!r}."
        )
    return merged(task_values(early.env, device_type), values)
