"""A run's folder: config, checkpoints and their fronts, metrics, TensorBoard events."""

import csv
import io
import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from filelock import FileLock, Timeout

from ..algorithms.learner import Learner
from ..configuration.config import MAY_CHANGE, Config, differences, load_config
from ..configuration.files import read_yaml, write_record
from ..envs import MorlaxError
from ..envs.errors import shortened
from ..envs.naming import movable, title
from ..evaluation.front import Front
from ..host.files import (
    AnyPath,
    Taken,
    attempting,
    is_file,
    is_folder,
    making,
    read,
    remove_drafts,
    unused,
    write_file,
)
from . import checkpoint, models
from .contents import Contents
from .hardware import read_machines, resumed, this_machine, write_machines
from .history import BEST, read_rows
from .progress import Evaluation, Progress
from .references import NAMES_CODE, copy_files, localized

if TYPE_CHECKING:
    from .tensorboard import Events


class RunLock:
    """The lock of a run's folder.

    The operating system releases it when its process ends, however it ends, so no lock is ever
    stale. `train.pid` names the process for error messages.
    """

    def __init__(self, folder: Path):
        self._folder, self._owner = folder, folder / "train.pid"
        self._lock = FileLock(folder / "train.lock", timeout=0)

    def acquire(self) -> None:
        """Take the lock, unless another process, or another run object of this one, holds it."""
        with attempting(f"lock {self._folder}"):
            try:
                self._lock.acquire()
                self._owner.write_text(str(os.getpid()))
            except Timeout:
                owner = "another process"
                with suppress(OSError):
                    owner = f"process {self._owner.read_text()}"
                raise MorlaxError(
                    f"{self._folder} is being trained by {owner}: wait until it ends, or stop it."
                ) from None

    def release(self) -> None:
        """Give the lock back, if it is held."""
        if self._lock.is_locked:
            with suppress(OSError):
                self._owner.unlink()
            self._lock.release()


def taken(folder: Path) -> MorlaxError:
    """Return the error of a new run whose folder is in use."""
    return MorlaxError(
        f"{folder} exists already: choose another --output, or continue the run with "
        f"--resume {folder}."
    )


def _begin(folder: Path, learner: Learner, contents: dict[str, Any]) -> None:
    (folder / "checkpoints").mkdir()
    latest, progress = folder / "checkpoints" / "latest.pt", Progress(evaluated=False)
    checkpoint.write_snapshot(latest, contents, progress)
    write_record(learner.config, folder)
    write_machines(folder, [this_machine(learner)])
    copy_files(learner.config, folder)


class Run:
    """`runs/<task>/<time>-<seed>/`, complete from the moment it exists.

    config.yaml     every number of the run
    hardware.yaml   the machines that trained it, in order
    metrics.csv     one row per evaluation
    front.npz       the front of checkpoints/best.pt
    checkpoints/    best.pt by hypervolume, latest.pt, and latest.npz, the front of latest.pt
    learned.pt      a learned reward, if the task has one
    events.*        TensorBoard

    One thread at a time may use it. As a context manager it closes itself.
    """

    def __init__(self, folder: AnyPath):
        self.folder = Path(folder)
        self._rows: list[dict[str, Any]] = []
        self._events: Events | None = None
        self._lock = RunLock(self.folder)
        self._purge_step: int | None = None  # TensorBoard drops events from this step on

    @classmethod
    def create(cls, learner: Learner, output: AnyPath | None = None) -> Self:
        """Create a folder that already holds the config and a first checkpoint.

        The folder is prepared beside its final place and then moved there, so that a killed
        program leaves either a run that can be resumed or none. All processes of the learner's
        group must call it; the first one writes.

        Args:
            learner: whose config and initial state to write.
            output: the folder (None: runs/<task>/<time>-<seed>).

        Raises:
            MorlaxError: the folder is in use, or cannot be written.
        """
        config, contents = learner.config, checkpoint.snapshot(learner)
        if learner.group.rank:
            return cls(Path(learner.group.first("")))
        stamp = time.strftime("%Y%m%d-%H%M%S")
        usual = Path("runs") / title(config.env) / f"{stamp}-{config.seed}"
        while True:
            folder = unused(usual) if output is None else Path(output)
            if is_folder(folder) and folder.samefile(os.curdir):
                raise MorlaxError("a run needs its own folder: choose another --output.")
            try:
                with making(folder) as draft:
                    _begin(draft, learner, contents)
                break
            except Taken:
                if output is not None:
                    raise taken(folder) from None
        run = cls(folder)
        run._lock.acquire()
        learner.group.first(str(folder))
        return run

    @classmethod
    def open(cls, folder: AnyPath) -> Self:
        """Open an existing run, the newest one of a folder of runs, or of all if it is "latest".

        Raises:
            MorlaxError: the folder is not a run.
        """
        folder = checkpoint.named_run(folder)
        if not is_file(Path(folder) / "config.yaml"):
            raise MorlaxError(f"{folder} is not a run: it has no config.yaml.")
        return cls(folder)

    def config(self, trust: bool = False, env: str | None = None) -> Config:
        """Return the config to resume the run with.

        It is that of the latest checkpoint, with the fields of MAY_CHANGE from config.yaml.

        Args:
            trust: allow the code that the config names.
            env: FILE.py:CLASS of the task, where it is now.

        Raises:
            MorlaxError: a file is damaged, config.yaml was edited where it may not change, or the
                config names code that is not trusted.
        """
        file, path = self.folder / "config.yaml", self.checkpoints / "latest.pt"
        values = read_yaml(file)
        stored = checkpoint.read_config(checkpoint.load(path), path, trust, env)
        task = values.get("env")
        if not isinstance(task, str) or movable(task) != movable(stored.env):
            raise MorlaxError(
                f"{path} is of task {stored.env!r}, not {shortened(task)}, as {file} says."
            )
        for field in NAMES_CODE:
            name = getattr(stored, field)
            if movable(str(values.get(field))) == movable(name):
                values[field] = name  # wherever it lies now
        try:
            edited = load_config(localized(values, self.folder, stored.env))
        except MorlaxError as error:
            raise MorlaxError(f"{file} does not fit: {error}") from None
        found = differences(stored, edited)
        if found:
            raise MorlaxError(
                f"{file} was edited since the run began ({'; '.join(found)}): undo that, or start "
                f"a new run with --config {file}. A resumed run may change only "
                f"{', '.join(MAY_CHANGE)}."
            )
        return stored.model_copy(update={name: getattr(edited, name) for name in MAY_CHANGE})

    def limit_reached(self, config: Config) -> str | None:
        """Return the option whose limit a run resumed with `config` has reached, if any.

        Raises:
            MorlaxError: a file is damaged.
        """
        contents = checkpoint.load(self.checkpoints / "latest.pt")
        metrics, reached = self.folder / "metrics.csv", contents.progress
        rows = read_rows(metrics) if metrics.exists() else []
        if contents.learner is None or not rows or not reached.evaluated:
            return None
        if int(rows[-1]["iteration"]) != contents.learner.get("iteration"):
            return None  # its last evaluation is missing
        limits = {
            "max-env-steps": (reached.env_steps, config.max_env_steps),
            "max-seconds": (reached.train_seconds, config.max_seconds),
        }
        return next((k for k, (now, end) in limits.items() if end is not None and now >= end), None)

    def restore(self, learner: Learner) -> Progress:
        """Load the latest checkpoint into `learner` and drop later log entries.

        All processes of the learner's group must call it.

        Raises:
            MorlaxError: another program trains the run, or the checkpoint does not fit.
        """
        first, path = learner.group.rank == 0, self.checkpoints / "latest.pt"
        if first:
            self._lock.acquire()
        try:
            contents = checkpoint.load(path)
            checkpoint.restore(contents, path, learner)
            if first:
                self._clear_up(learner, contents)
        except BaseException:
            self._lock.release()
            raise
        now = models.of_worlds(learner.env)
        changed = bool(models.difference(contents.environment.model_fingerprint, now))
        return _continued(contents, learner.config, changed)

    def _clear_up(self, learner: Learner, contents: Contents) -> None:
        """Drop what was logged after a checkpoint, and complete best.pt if it is the checkpoint.

        Also update config.yaml and hardware.yaml.
        """
        metrics, machines = self.folder / "metrics.csv", read_machines(self.folder)
        rows = read_rows(metrics) if metrics.exists() else []
        last = learner.iteration if contents.progress.evaluated else learner.iteration - 1
        self._rows = [row for row in rows if int(row["iteration"]) <= last]
        dropped = [int(row["iteration"]) for row in rows[len(self._rows) :]]
        if dropped:
            self._write_rows()
        repeats = not contents.progress.evaluated and learner.iteration in (0, *dropped)
        self._purge_step = learner.env_steps + (0 if repeats else 1)
        if self.has_evaluation(learner.iteration) and float(self._rows[-1].get(BEST) or 0):
            mark = checkpoint.fingerprint(contents.agent)
            names = "latest.pt", "best.pt"
            latest, best = (_front_of(mark, self.checkpoints / name) for name in names)
            if latest is not None and best is None:
                self._save_best(latest)
        write_record(learner.config, self.folder)
        copy_files(learner.config, self.folder)
        write_machines(self.folder, resumed(machines, this_machine(learner)))
        for folder in (self.folder, self.checkpoints):
            remove_drafts(folder)

    @property
    def checkpoints(self) -> Path:
        return self.folder / "checkpoints"

    def save(
        self, contents: dict[str, Any], progress: Progress, evaluation: Evaluation | None = None
    ) -> None:
        """Write a `checkpoint.snapshot` to latest.pt, and to best.pt too if it is the best.

        `evaluation` is that of the snapshot, if it was evaluated; its row is in metrics.csv
        already. latest.pt decides whether it counts: a program that is killed before leaves a row
        that `restore` drops, and one that is killed after it leaves the front from which `restore`
        completes best.pt.
        """
        path, iteration = self.checkpoints / "latest.pt", contents["learner"]["iteration"]
        if evaluation is not None:
            _save_front(evaluation.front, path)
        evaluated = {"evaluated": self.has_evaluation(iteration)}
        checkpoint.write_snapshot(path, contents, progress.model_copy(update=evaluated))
        if evaluation is not None and evaluation.best:
            self._save_best(evaluation.front)

    def _save_best(self, front: Front) -> None:
        """Make the latest checkpoint, with this front, the best one."""
        best = self.checkpoints / "best.pt"
        write_file(best, read(self.checkpoints / "latest.pt", "checkpoint"))
        _save_front(front, best)

    def has_evaluation(self, iteration: int) -> bool:
        """Return whether metrics.csv has a row for this iteration."""
        return any(int(row["iteration"]) == iteration for row in self._rows)

    def log_metrics(
        self, metrics: Mapping[str, float], env_steps: int, steps_per_second: float
    ) -> None:
        """Write the learner's metrics to TensorBoard."""
        with self._written() as events:
            events.log_metrics({**metrics, "env_steps_per_second": steps_per_second}, env_steps)

    def log_evaluation(self, evaluation: Evaluation, task: str) -> None:
        """Write an evaluation of a `task`: events and a row of metrics.csv."""
        with self._written() as events:
            events.log_evaluation(evaluation, task, _shows_pictures(len(self._rows)))
        self._rows.append(evaluation.row())
        self._write_rows()

    def _write_rows(self) -> None:
        metrics, table = self.folder / "metrics.csv", io.StringIO()
        if not self._rows:
            metrics.unlink(missing_ok=True)
            return
        writer = csv.DictWriter(table, dict.fromkeys(chain(self._rows[-1], *self._rows)))
        writer.writeheader()
        writer.writerows(self._rows)
        write_file(metrics, table.getvalue())

    @contextmanager
    def _written(self) -> "Iterator[Events]":
        with attempting(f"write events in {self.folder}"):
            if self._events is None:
                from .tensorboard import Events  # loads slowly

                self._events = Events(self.folder, self._purge_step)
            yield self._events

    def close(self) -> None:
        """Write and close the TensorBoard events, and let other processes train the run."""
        try:
            with self._written() as events:
                events.close()
        finally:
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except MorlaxError:
            if kind is None or issubclass(kind, GeneratorExit):
                raise  # else on a full disk this error would hide the first one


def _save_front(front: Front, path: Path) -> None:
    """Write the front of a checkpoint beside it."""
    front._replace(checkpoint=path.name).save(checkpoint.front_path(path))


def _front_of(mark: str, path: Path) -> Front | None:
    """Return the front beside a checkpoint, if it is of the policies of this fingerprint."""
    with suppress(MorlaxError):  # it is missing or damaged
        front = Front.load(checkpoint.front_path(path))
        return front if front.fingerprint == mark else None
    return None


def _continued(contents: Contents, config: Config, changed: bool) -> Progress:
    """Return the progress of a checkpoint that a run with `config` goes on from.

    Another protocol, other trade-offs or episodes, and a `changed` model give other hypervolumes,
    so with them the record of the best checkpoint begins anew.
    """
    progress, given = contents.progress, contents.config.get("evaluation", {})
    evaluation = type(config.evaluation).model_validate(given)
    if changed or not evaluation.measures_like(config.evaluation):
        return progress.model_copy(update={"best_selection": None, "best_hypervolume": 0.0})
    return progress


def _shows_pictures(evaluation: int) -> bool:
    """Return whether TensorBoard gets pictures of an evaluation, counted from 0.

    After the first ten, each is a tenth later than the last, so that a long run stays small.
    """
    if evaluation < 10:
        return True
    steps = [int(math.log(number, 1.1)) for number in (evaluation - 1, evaluation)]
    return steps[0] < steps[1]
