"""Search for a task's hyperparameters."""

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import PositiveFloat

from ..configuration.config import Config
from ..configuration.files import space_values
from ..envs import MorlaxError
from ..envs.naming import title
from ..envs.worlds.options import Count
from ..host.torchrun import SEVERAL
from .terminal.arguments import Start, begin, placed, values_over
from .terminal.cli import Live, console, print_command
from .terminal.process import interruptible, typed


class Tune(Start):
    """Search for a task's hyperparameters with Optuna."""

    shown = {
        "What to tune": ("env", "algorithm", "config", "space", "device"),
        "The search": ("trials", "seconds", "minutes", "output"),
    }
    examples = ("--env cheetah --minutes 60", "--env hopper --space my_space.yaml")
    trials: Count = 50
    """Number of trials of the study; finished ones count, so the same command resumes."""
    seconds: PositiveFloat = 60.0
    """Training time of each trial, without compiling and evaluating, in seconds."""
    minutes: PositiveFloat | None = None
    """Limit of the whole search, in minutes; a trial that runs then is queued again."""
    space: Path | None = None
    """A YAML file of options and their values (None: configs/tuning/space.yaml)."""
    output: Path | None = None
    """Folder of the study, which several processes may share (None: tuning/<task>)."""


def read(arguments: Sequence[str]) -> tuple[Config, Tune]:
    """Read the config of the file or task that is named, and options."""
    options, others = begin(Tune, arguments)
    line = " ".join(others).replace("_", "-")
    ours = "max-seconds", "max-env-steps", "evaluation.every"
    if any(f"--{name}" in line for name in ours):
        raise MorlaxError(f"the search sets {', '.join(ours)} itself: use --seconds instead.")
    return placed(values_over(options, others) | {"max_seconds": options.seconds}), options


def command(arguments: Sequence[str]) -> None:
    if SEVERAL:
        raise MorlaxError("tune uses one GPU: start it without torchrun, once for each GPU.")
    config, options = read(arguments)
    from ..tuning.study import Search  # imports torch

    space = space_values(options.space, str(config.device).partition(":")[0])
    folder = options.output or Path("tuning") / title(config.env)
    search = Search(config, space, folder, options.seconds)
    end = time.monotonic() + 60 * (options.minutes or math.inf)

    def show(study: Any, trial: Any) -> None:
        changes = [
            f"{name.rpartition('.')[2]}={f'{value:.3g}' if isinstance(value, float) else value}"
            for name, value in trial.params.items()
            if value != search.base_draw[name]
        ]
        text = trial.user_attrs.get("reason") or " ".join(changes) or "the base config"
        state, value = trial.state.name.lower(), trial.value or 0.0
        console.print(f"{trial.number:5d}  {state:8}  {value:11.4e}  {text}")

    console.print(f"{options.trials} trials, {len(search.finished())} of them done: {folder}")
    console.print("trial  state     hypervolume  changed options")
    with interruptible() as interrupted, Live():
        search.run(options.trials, lambda: interrupted() or time.monotonic() >= end, show)
    finished, ranked = search.finished(), search.ranked()
    console.print(f"{len(finished)} of {options.trials} trials done; the best:")
    for trial in ranked[:5]:
        show(search.study, trial)
    if len(finished) < options.trials:
        print_command("continue", typed("tune", *arguments))
    if ranked:
        print_command("next", typed("train", "--config", folder / "best.yaml"))
    if interrupted():
        interrupted.exit()
    if finished and not ranked:
        raise MorlaxError(f"no trial is complete: {finished[-1].user_attrs.get('reason')}")
