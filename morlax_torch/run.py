"""A run's folder: config, checkpoints, metrics, TensorBoard events, the latest front."""

import csv
import io
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import yaml
from pydantic import BaseModel
from torch.utils.tensorboard import SummaryWriter

from . import checkpoint, envs
from .config import Config, load_config, read_yaml
from .envs import MorlaxError
from .evaluation import Front, hypervolume_in
from .figures import front_figure
from .files import replacing, unused
from .morlax import MORLAX


class Progress(BaseModel):
    """A run's own counters."""

    train_seconds: float = 0.0
    """Exploring and learning alone: without compiling, evaluating and saving."""
    total_seconds: float = 0.0
    """Everything, since the command began; of all sessions of a resumed run."""
    steps_per_second: float = 0.0
    hypervolume: float = 0.0
    best_hypervolume: float = 0.0

    def judge(self, row: Mapping[str, Any]) -> bool:
        """Note the hypervolume of an evaluation; whether it is the best so far."""
        self.hypervolume = row[hypervolume_in(row)]
        best = self.hypervolume > self.best_hypervolume
        self.best_hypervolume = max(self.hypervolume, self.best_hypervolume)
        return best


class Run:
    """`runs/<task>/<time>-<seed>/`, complete from the moment it exists.

    config.yaml     every number of the run
    metrics.csv     a row for each evaluation
    front.npz       the latest evaluation
    checkpoints/    latest.pt, and best.pt by hypervolume
    events.*        TensorBoard
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._rows: list[dict[str, Any]] = []
        self._events: SummaryWriter | None = None
        self._purge_step: int | None = None  # TensorBoard forgets what came from here on

    @classmethod
    def create(cls, morlax: MORLAX, output: Path | None) -> Self:
        """A new folder that already holds the config and a first checkpoint.

        It is prepared beside its place and then moved there, so that whenever the program is
        killed there is either a run that can be resumed or none.

        Raises:
            MorlaxError: the folder is in use, or cannot be written.
        """
        config = morlax.config
        stamp = time.strftime("%Y%m%d-%H%M%S")
        folder = output or unused(Path("runs") / envs.title(config.env) / f"{stamp}-{config.seed}")
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise MorlaxError(
                f"{folder} is there already: choose another --output, or go on with the run by "
                f"--resume {folder}."
            )
        if folder.resolve() == Path.cwd():
            raise MorlaxError("a run takes a folder of its own: choose another --output.")
        draft = folder.with_name(f".{folder.name}.draft")
        try:
            shutil.rmtree(draft, ignore_errors=True)
            (draft / "checkpoints").mkdir(parents=True)
            checkpoint.save(draft / "checkpoints" / "latest.pt", morlax, Progress().model_dump())
            with replacing(draft / "config.yaml") as file:
                file.write(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False).encode())
            draft.replace(folder)
        except OSError as error:
            raise MorlaxError(f"cannot make {folder}: {error.strerror or error}.") from None
        finally:
            shutil.rmtree(draft, ignore_errors=True)
        return cls(folder)

    @classmethod
    def open(cls, folder: Path) -> Self:
        """A run that is there already.

        Raises:
            MorlaxError: it is not.
        """
        if not (folder / "config.yaml").is_file():
            raise MorlaxError(f"{folder} is no run: it has no config.yaml.")
        return cls(folder)

    def config(self) -> Config:
        """What it was made with."""
        return load_config(read_yaml(self.folder / "config.yaml"))

    def restore(self, morlax: MORLAX) -> Progress:
        """Put the latest checkpoint into `morlax` and forget what was logged after it."""
        path = self.checkpoints / "latest.pt"
        contents = checkpoint.load(path, morlax.env.device)
        checkpoint.restore(contents, path, morlax)
        metrics = self.folder / "metrics.csv"
        if metrics.is_file():
            with metrics.open(newline="") as file:
                rows = list(csv.DictReader(file))
            self._rows = [row for row in rows if int(row["iteration"]) <= morlax.iteration]
        self._purge_step = morlax.env_steps + 1
        return Progress(**contents["progress"])

    @property
    def checkpoints(self) -> Path:
        return self.folder / "checkpoints"

    def save(self, morlax: MORLAX, progress: Progress, best: bool = False) -> None:
        """Write the latest checkpoint; one that is `best` is kept apart too."""
        for name in ("best", "latest") if best else ("latest",):
            checkpoint.save(self.checkpoints / f"{name}.pt", morlax, progress.model_dump())

    def has_evaluation(self, iteration: int) -> bool:
        return any(int(row["iteration"]) == iteration for row in self._rows)

    def log_metrics(self, metrics: Mapping[str, float], morlax: MORLAX, progress: Progress) -> None:
        """Curves of what the learner says of itself."""
        curves = {**metrics, "env_steps_per_second": progress.steps_per_second}
        with self._written() as events:
            for name, value in curves.items():
                events.add_scalar(f"train/{name}", value, morlax.env_steps)

    def log_evaluation(self, front: Front, morlax: MORLAX, progress: Progress) -> dict[str, Any]:
        """An evaluation: curves, a picture, front.npz and a row of metrics.csv, returned."""
        indicators = front.indicators()
        milliseconds = round(1000 * progress.train_seconds)
        task = envs.title(morlax.config.env)
        title = f"{task} after {morlax.env_steps / 1e6:.1f} M environment steps"
        with self._written() as events:
            for name, value in indicators.items():
                events.add_scalar(f"front/{name}", value, morlax.env_steps)
                events.add_scalar(f"front_by_train_ms/{name}", value, milliseconds)
            events.add_figure("front", front_figure(front, title), morlax.env_steps)
            events.flush()
        front.save(self.folder / "front.npz")
        row = {
            "iteration": morlax.iteration,
            "env_steps": morlax.env_steps,
            "train_seconds": round(progress.train_seconds, 3),
            "total_seconds": round(progress.total_seconds, 3),
            **indicators,
            "steps_per_second": round(progress.steps_per_second),
        }
        self._rows.append(row)
        table = io.StringIO()
        writer = csv.DictWriter(table, row)
        writer.writeheader()
        writer.writerows(self._rows)
        with replacing(self.folder / "metrics.csv") as file:
            file.write(table.getvalue().encode())
        return row

    @contextmanager
    def _written(self) -> Iterator[SummaryWriter]:
        """The TensorBoard events, to add to."""
        try:
            if self._events is None:
                self._events = SummaryWriter(str(self.folder), purge_step=self._purge_step)
                config = (self.folder / "config.yaml").read_text()
                self._events.add_text("config", "\n".join(f"    {x}" for x in config.splitlines()))
            yield self._events
        except OSError as error:
            reason = error.strerror or error
            raise MorlaxError(f"cannot write events in {self.folder}: {reason}.") from None

    def close(self) -> None:
        """Write what is not written yet."""
        with self._written() as events:
            events.close()
