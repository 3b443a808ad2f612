"""Search for a task's hyperparameters."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, PositiveFloat

from ..configuration.config import Config
from ..configuration.sections import Indicator
from ..envs import MorlaxError
from ..envs.naming import title
from ..envs.worlds.options import Count
from ..host.torchrun import SEVERAL
from .terminal.arguments import Start, begin, placed, values_over
from .terminal.cli import Live, console, print_command
from .terminal.process import Interruption, interruptible, typed

if TYPE_CHECKING:
    from ..tuning.study import Search

PARENT = "MORLAX_TUNE_PARENT"  # set in workers: the process that waits for them
OURS = "max-seconds", "max-env-steps", "evaluation.every"  # options that the search sets itself
BEST = 5  # trials that are listed at the end
PAUSE = 0.5  # seconds between looks at what workers have done


class Tune(Start):
    """Search for a task's hyperparameters with Optuna."""

    shown = {
        "What to tune": ("env", "algorithm", "config", "space", "indicators", "device"),
        "The search": ("trials", "seconds", "minutes", "workers"),
        "Where it is kept": ("output", "storage", "study"),
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
    storage: str | None = None
    """A journal file, or the URL of a database, which several processes and machines may share
    (None: journal.log in the output folder)."""
    study: str | None = Field(default=None, min_length=1, max_length=200)
    """Name of the study in its storage (None: the task)."""
    output: Path | None = None
    """Folder of best.yaml and trials.csv (None: tuning/<task>)."""
    indicators: tuple[Indicator, ...] = ("hypervolume",)
    """Indicators of fronts to optimize; with several, no trial is pruned."""
    workers: Annotated[int, Field(ge=1, le=1024)] | None = None
    """Number of processes that run trials (None: one per visible GPU, one on a CPU)."""


def read(arguments: Sequence[str]) -> tuple[Config, Tune, bool]:
    """Read the config of the file or task that is named, options, and whether one GPU is named."""
    options, others = begin(Tune, arguments)
    line = " ".join(others).replace("_", "-")
    if any(f"--{name}" in line for name in OURS):
        raise MorlaxError(f"the search sets {', '.join(OURS)} itself: use --seconds instead.")
    values = values_over(options, others) | {"max_seconds": options.seconds}
    return placed(values), options, ":" in str(values["device"])


def command(arguments: Sequence[str]) -> None:
    if SEVERAL:
        raise MorlaxError("tune has --workers of its own: start it without torchrun.")
    config, options, one_gpu = read(arguments)
    from ..tuning.study import Search  # imports torch

    others = {*Start.model_fields, "trials", "minutes", "workers"}
    search = Search(config, **options.model_dump(exclude=others))
    parent, end = os.environ.get(PARENT), time.monotonic() + 60 * (options.minutes or math.inf)
    with interruptible() as interrupted:

        def stopped() -> bool:
            orphaned = parent is not None and parent != str(os.getppid())
            return interrupted() or orphaned or time.monotonic() >= end

        if parent is not None:
            search.run(options.trials, stopped)
            return
        search.write()  # a folder that cannot be written is told before training
        gpus = visible_gpus(str(config.device), options.workers, one_gpu)
        console.print(
            f"{title(config.env)}: {options.trials} trials of {options.seconds:g} s, "
            f"{len(search.finished())} of them done; {len(gpus)} x {config.device}"
        )
        console.print(f"study {search.study.study_name} in {search.storage}")
        console.print(search.heads())
        if len(gpus) > 1:
            _run_workers(arguments, gpus, search, interrupted)
        else:
            with Live():
                search.run(options.trials, stopped, lambda trial: console.print(search.line(trial)))
        _print_end(search, options.trials, arguments)
    if interrupted():
        interrupted.exit()


def visible_gpus(device: str, workers: int | None, one_gpu: bool) -> list[str | None]:
    """Return the value of CUDA_VISIBLE_DEVICES for each worker; None: as it is."""
    import torch

    if device == "cpu" or one_gpu:
        return [None] * (workers or 1)
    count = torch.cuda.device_count()
    named = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    gpus = named.split(",")[:count] if named else [str(index) for index in range(count)]
    return [gpus[index % count] for index in range(workers or count)]


def _run_workers(
    arguments: Sequence[str], gpus: list[str | None], search: "Search", interrupted: Interruption
) -> None:
    """Run a `tune` for each of the GPUs until all have ended, and print their trials."""
    threads = str(max(1, (os.cpu_count() or 1) // len(gpus)))
    command = [sys.executable, "-m", "morlax_torch", "tune", *arguments]
    workers, printed = [], {trial.number for trial in search.finished()}
    for gpu in gpus:
        environment = {"OMP_NUM_THREADS": threads, **os.environ, PARENT: str(os.getpid())}
        if gpu is not None:
            environment["CUDA_VISIBLE_DEVICES"] = gpu
        # in a group of its own, the terminal's Ctrl-C reaches it through this process only
        workers.append(subprocess.Popen(command, env=environment, process_group=0))
    try:
        with Live() as live:
            running = True
            while running:
                time.sleep(PAUSE)
                running = any(worker.poll() is None for worker in workers) and not interrupted()
                numbers = [str(trial.number) for trial in search.running()[-len(gpus) :]]
                live.show(f"trials {', '.join(numbers)}")
                for trial in search.finished():
                    if trial.number not in printed:
                        printed.add(trial.number)
                        console.print(search.line(trial))
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.wait()
    finally:
        for worker in workers:
            worker.kill()
    if all(worker.returncode for worker in workers) and not interrupted():
        raise MorlaxError(f"all {len(workers)} workers ended early: see the lines above.")


def _print_end(search: "Search", trials: int, arguments: Sequence[str]) -> None:
    """Print the best trials and the next command, or raise MorlaxError if all have failed."""
    finished, ranked = search.finished(), search.ranked()
    console.print(f"{len(finished)} of {trials} trials done; the best:")
    for trial in ranked[:BEST]:
        console.print(search.line(trial))
    if shares := search.importances():
        listed = ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
        console.print(f"how much options decide whether a trial is among the best: {listed}")
    if len(finished) < trials:
        print_command("continue", typed("tune", *arguments))
    if ranked:
        print_command("next", typed("train", "--config", search.folder / "best.yaml"))
    elif finished:
        last = finished[-1].user_attrs.get("reason")
        raise MorlaxError(f"no trial is complete, the last one because: {last}")
