"""Live progress in the terminal."""

from pathlib import Path
from typing import Any, Self

from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from .cli import console
from .config import Config
from .envs import Environment, Worlds, title
from .evaluation import hypervolume_in
from .run import Progress


class Display:
    """A bar that moves on a terminal; on a file or a pipe only a line for each evaluation."""

    def __init__(self, config: Config, env: Worlds, folder: Path):
        self.config, self.env, self.folder = config, env, folder
        self._bar = Bar(
            BarColumn(bar_width=24),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=1.0)

    def __enter__(self) -> Self:
        c = self.config
        console.print(
            f"{title(c.env)}: {', '.join(c.task.objectives)}; {c.worlds} worlds on "
            f"{self.env.device} ({self.env.simulator}), {c.num_clusters} trade-offs at a time, "
            f"seed {c.seed}"
        )
        console.print(f"{self.folder}  (tensorboard --logdir {self.folder.parent})")
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def say(self, text: str) -> None:
        console.print(text)
        self._bar.update(self._task, description=text)

    def update(self, env_steps: int, progress: Progress) -> None:
        """Show where training is, how fast, and how long it will still take."""
        done, left = 0.0, float("inf")
        limits = (
            (env_steps, self.config.max_env_steps, progress.steps_per_second),
            (progress.train_seconds, self.config.max_seconds, 1.0),
        )
        for value, limit, speed in limits:
            if limit is not None and (limit - value) / speed < left:
                done, left = value / limit, max(0.0, (limit - value) / speed)
        until = f", {_duration(left)} left" if left < float("inf") else ""
        text = (
            f"{_count(env_steps)} steps, {_count(progress.steps_per_second)} steps/s, "
            f"hypervolume {progress.hypervolume:.3e} (best {progress.best_hypervolume:.3e}){until}"
        )
        self._bar.update(self._task, completed=done, description=text)

    def evaluated(self, row: dict[str, Any]) -> None:
        """A line for an evaluation."""
        name = hypervolume_in(row)
        console.print(
            f"{_count(row['env_steps']):>8} steps {row['train_seconds']:7.1f} s  "
            f"{name.replace('_', ' ')} {row[name]:.4e}  front of {row['cardinality']:3d}  "
            f"{_count(row['steps_per_second']):>8} steps/s"
        )

    def finished(self, env_steps: int, progress: Progress, interrupted: bool) -> None:
        console.print(
            f"{'interrupted' if interrupted else 'done'}: {_count(env_steps)} steps in "
            f"{progress.train_seconds:.1f} s of training ({progress.total_seconds:.1f} s in all), "
            f"best hypervolume {progress.best_hypervolume:.4e}"
        )
        may_resume = isinstance(self.env, Environment)  # others cannot save their state
        more = "train --resume" if interrupted and may_resume else "evaluate"
        console.print(f"next: python -m morlax_torch.{more} {self.folder}")


def _count(number: float) -> str:
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= size:
            return f"{number / size:.2f} {unit}"
    return f"{number:.0f}"


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}"
