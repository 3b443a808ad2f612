"""Live progress in the terminal."""

import shlex
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Self

from ...algorithms.learner import Learner
from ...envs.naming import runs_code, title
from ...evaluation.front import hypervolume_in
from ...reports.verdict import unreached
from ...runs.progress import Evaluation, Progress
from ...runs.references import NAMES_CODE
from ...runs.training import SHORT, TRAINING, is_short
from .cli import Live, console, print_command
from .process import typed

SLOW = 1000.0  # steps/s; hyper-sac learns from 500 on one CPU core


class Display(Live):
    """A line per evaluation, and in between a moving bar; on a file or pipe a line at times.

    Only the first of several processes shows anything. `progress` is read live while training
    updates it.
    """

    def __init__(self, learner: Learner, folder: Path, progress: Progress):
        super().__init__()
        self._learner, self._folder, self._progress = learner, folder, progress
        self._named = False  # the columns
        self._hinted = False
        self._unreached: str | None = None  # why the latest hypervolume of trained policies is 0

    def __enter__(self) -> Self:
        for line in self._introduction():
            console.print(line)
        return super().__enter__()

    def _introduction(self) -> Iterator[str]:
        config, env, progress = self._learner.config, self._learner.env, self._progress
        yield (
            f"{title(config.env)}: {', '.join(config.task.objectives)}; {config.worlds} worlds on "
            f"{env.device} ({env.simulator}), {config.num_clusters} trade-offs at a time, "
            f"seed {config.seed}"
        )
        yield f"{self._folder}  (tensorboard --logdir {shlex.quote(str(self._folder.parent))})"
        if not env.shows_endings:
            yield (
                "these worlds do not show how an episode ended: steps at a time limit are left out "
                "(ppo.truncation mask)"
            )
        processes = self._learner.group.size
        if progress.env_steps and not env.resumable:
            yield "the state of these worlds cannot be saved: they start anew"
        elif progress.env_steps and progress.processes != processes:
            yield (
                f"number of processes: {processes} instead of {progress.processes}, so worlds "
                "start anew"
            )
        if progress.hypervolume and progress.best_selection is None:
            yield (
                "evaluations are not those of the run so far: its record of the best checkpoint "
                "begins anew"
            )
        if env.simulator == "mjlab" and env.device.type == "cpu":
            yield "on a CPU, mjlab takes a few hundred steps per second: use a GPU to train"
        if is_short(config):
            yield f"training takes less than {SHORT:.0f} s, so it is evaluated only at its end"
        if env.simulator == "MuJoCo Warp":
            yield "compiling kernels: up to a minute the first time on a machine"

    def evaluated(self, evaluation: Evaluation) -> None:
        """Print a line for an evaluation, and the names of its columns before the first line."""
        self._told = True
        row = evaluation.row()
        name = hypervolume_in(row)
        volume = name.replace("_", " ")
        if not self._named:
            self._named = True
            console.print(f"   steps  train (s)  total (s)  {volume}  front    steps/s")
        console.print(
            f"{_count(row['env_steps']):>8}  {row['train_seconds']:9.1f}  "
            f"{row['total_seconds']:9.1f}  {row[name]:{len(volume)}.4e}  "
            f"{row['cardinality']:5d}  {_count(row['steps_per_second']):>9}"
        )
        blowups = [f"{_count(row['blowups'])} while training"] if row["blowups"] else []
        if row.get("blowup_rate"):
            blowups.append(f"{row['blowup_rate']:.1%} of the evaluated episodes")
        if blowups:
            console.print(f"{'':8}  blow-ups: {', '.join(blowups)}")
        # untrained policies need not exceed the reference point
        reason = unreached(evaluation.front) if evaluation.env_steps else None
        before, self._unreached = self._unreached, reason
        if self._unreached and not before:
            console.print(f"{self._unreached}.")
        self._hint(row["steps_per_second"])

    def _hint(self, speed: float) -> None:
        """Name the algorithm that needs fewer steps where steps take long."""
        config = self._learner.config
        other = config.algorithm != "morlax" or config.scalarization != "linear"
        if self._hinted or other or config.sampling.designs or not 0 < speed < SLOW:
            return
        self._hinted = True
        console.print(
            f"at {speed:.0f} steps/s, --algorithm hyper-sac may find a front sooner, because it "
            "needs fewer steps (docs/algorithms.md#hyper-sac)"
        )

    def finished(self, interrupted: bool) -> None:
        progress = self._progress
        evaluated = progress.best_selection is not None
        best = f", best hypervolume {progress.best_hypervolume:.4e}" if evaluated else ""
        console.print(
            f"{'interrupted' if interrupted else 'done'}: {_count(self._learner.env_steps)} steps "
            f"in {progress.train_seconds:.1f} s of training ({progress.total_seconds:.1f} s in "
            f"total){best}"
        )
        if self._unreached and not progress.best_hypervolume:
            console.print(f"{self._unreached}.")
        config = self._learner.config
        trusted = any(runs_code(getattr(config, name)) for name in NAMES_CODE)
        more = ("train", "--resume") if interrupted else ("evaluate",)
        print_command("next", typed(*more, self._folder, *["--trust"] * trusted))

    def describe(self, name: str, share: float | None) -> str:
        """Say how far training is, how fast, and how long it will still take."""
        config, progress = self._learner.config, self._progress
        if name != TRAINING or not progress.steps_per_second:
            return super().describe(name, share)
        limits = (
            (progress.env_steps, config.max_env_steps, progress.steps_per_second),
            (progress.train_seconds, config.max_seconds, 1.0),
        )
        left = [(limit - value) / speed for value, limit, speed in limits if limit is not None]
        until = f", {timedelta(seconds=round(max(0.0, min(left))))} left" if left else ""
        return (
            f"{_count(progress.env_steps)} steps, {_count(progress.steps_per_second)}/s, "
            f"hypervolume {progress.hypervolume:.3e}{until}"
        )


def _count(number: float) -> str:
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= size:
            return f"{number / size:.2f} {unit}"
    return f"{number:.0f}"
