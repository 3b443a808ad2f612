"""The command line of `tune`: the search, and the config below it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, PositiveFloat

from ...configuration.config import Config, flat
from ...envs import MorlaxError
from ...envs.worlds.options import Count
from .arguments import (
    Start,
    begin,
    draft,
    placed,
    values_over,
)

OURS = {  # options of a config that the search sets itself
    "max_seconds": "--seconds",
    "max_env_steps": "--seconds",
    "evaluation.every": "even times of each trial",
}


class TuneOptions(Start):
    """Search for a task's hyperparameters with Optuna."""

    command = "tune"
    shown = {
        "What to tune": ("env", "algorithm", "config", "space", "indicators", "device"),
        "The search": ("trials", "seconds", "minutes", "workers"),
        "Where it is kept": ("output", "storage", "study"),
    }
    examples = (
        "--env cheetah --minutes 60",
        "--env hopper --space my_space.yaml",
    )
    trials: Count = 50
    """Number of trials of the study; finished ones count, so the same command resumes."""
    seconds: PositiveFloat = 60.0
    """Training time of each trial, without compiling and evaluating, in seconds."""
    minutes: PositiveFloat | None = None
    """Limit of the whole search, in minutes; a trial that runs then is queued again."""
    space: Path | None = None
    """A YAML file of options and their values (None: configs/tuning/space.yaml)."""
    storage: str | None = None
    """A journal file, or the URL of a database, which several processes and machines may share
    (None: journal.log in the output folder)."""
    study: str | None = Field(default=None, min_length=1, max_length=200)
    """Name of the study in its storage (None: the task)."""
    output: Path | None = None
    """Folder of best.yaml and trials.csv (None: tuning/<task>)."""
    indicators: tuple[
        Literal["hypervolume", "expected_utility", "sparsity", "obedience", "cardinality"], ...
    ] = ("hypervolume",)
    """Indicators of fronts to optimize; with several, no trial is pruned."""
    workers: Annotated[int, Field(ge=1, le=1024)] | None = None
    """Number of processes that run trials (None: one per visible GPU, one on a CPU)."""


class Request(NamedTuple):
    """A parsed command line of `tune`."""

    config: Config
    options: TuneOptions
    one_gpu: bool  # whether it names one of the GPUs


def read(arguments: Sequence[str]) -> Request:
    """Read the command line over the config of the file or task that it names."""
    options, others = begin(TuneOptions, arguments)
    below = draft(options)
    values = values_over(below, options, others)
    one_gpu = ":" in (values["device"] or "")
    own, usual = flat(values), flat(below.model_dump())
    for name, instead in OURS.items():
        if own[name] != usual[name]:
            option = name.replace("_", "-")
            raise MorlaxError(f"the search sets {name} by {instead}: leave out --{option}.")
    config = placed({**values, "max_seconds": options.seconds})
    return Request(config, options, one_gpu)
