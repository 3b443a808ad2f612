"""A run's folder: config, checkpoints and their fronts, metrics, TensorBoard events."""

import json
import math
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cached_property
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from filelock import FileLock, Timeout

from ..algorithms.learner import Learner
from ..configuration.config import MAY_CHANGE, Config, changed, check_resumable, flat, load_config
from ..configuration.files import read_yaml, write_record
from ..envs import MorlaxError
from ..envs.naming import movable, title
from ..envs.worlds.options import STORED
from ..evaluation.front import Front
from ..host import files
from ..host.files import AnyPath, attempting
from . import checkpoint
from .checkpoint import Contents
from .hardware import FILE as HARDWARE
from .hardware import Machine, read_machines, write_machines
from .loading import named_run, trust_run
from .progress import BEST, FRONTS, Evaluation, Progress, read_rows
from .references import NAMES_CODE, copy_files, localized

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter


LOCK = "train.lock"
PATIENCE = 0.2  # s that training waits for a lock, which `is_training` may hold for a moment


def taken(folder: Path) -> MorlaxError:
    is_run = (folder / "config.yaml").is_file()
    more = f", or continue the run with --resume {folder}" if is_run else ""
    return MorlaxError(f"{folder} exists already: choose another --output{more}.")


class Run:
    """`runs/<task>/<time>-<seed>/`, complete from the moment it exists.

    config.yaml     every number of the run
    hardware.yaml   the machines that trained it, in order
    metrics.csv     one row per evaluation
    front.npz       the front of checkpoints/best.pt
    checkpoints/    best.pt by hypervolume, latest.pt, and latest.npz, the front of latest.pt
    fronts/         ITERATION.npz: the fronts of evaluations that are a `milestone`, and the newest
    events.*        TensorBoard

    One thread at a time may use it. As a context manager it closes itself.
    """

    def __init__(self, folder: AnyPath):
        self.folder = Path(folder)
        self.checkpoints, self.fronts = self.folder / "checkpoints", self.folder / FRONTS
        self._metrics = self.folder / "metrics.csv"
        self._rows: list[dict[str, Any]] = []
        self._lock = FileLock(self.folder / LOCK, timeout=PATIENCE)  # ends with its process
        self._writing = f"write events in {self.folder}"
        self._purge_step: int | None = None  # TensorBoard drops events from this step on

    @classmethod
    def create(cls, learner: Learner, output: AnyPath | None = None) -> Self:
        """Create a folder (None: runs/<task>/<time>-<seed>) with the config and a first checkpoint.

        A killed program leaves a run that can be resumed or none. All processes of the learner's
        group must call it; the first one writes.
        """
        config, contents = learner.config, checkpoint.snapshot(learner)
        if learner.group.rank:
            return cls(learner.group.first(""))
        name = f"{time.strftime('%Y%m%d-%H%M%S')}-{config.seed}"
        while True:
            folder = Path(output or files.unused(Path("runs") / title(config.env) / name))
            try:
                with files.making(folder) as draft:
                    (draft / "checkpoints").mkdir()
                    latest = draft / "checkpoints" / "latest.pt"
                    checkpoint.write(latest, contents, Progress(evaluated=False))
                    write_record(config, draft)
                    write_machines(draft, [Machine.of(learner)])
                    copy_files(config, draft)
                break
            except files.Taken:
                if output is not None:
                    raise taken(folder) from None
        run = cls(folder)
        run._acquire()
        learner.group.first(str(folder))
        return run

    @classmethod
    def open(cls, folder: AnyPath) -> Self:
        """Open an existing run, the newest one of a folder of runs, or of all if it is "latest"."""
        folder = named_run(folder)
        if not (folder / "config.yaml").is_file():
            raise MorlaxError(f"{folder} is not a run: it has no config.yaml.")
        return cls(folder)

    def config(self, trust: bool = False, env: str | None = None) -> Config:
        """Return the latest checkpoint's config, with the fields of MAY_CHANGE from config.yaml."""
        file, path = self.folder / "config.yaml", self.checkpoints / "latest.pt"
        trust_run(path, trust, env)
        stored, values = checkpoint.read_config(checkpoint.load(path), path), read_yaml(file)
        values = _moved(values, stored)
        if values.get("env") != stored.env:
            raise MorlaxError(f"{path} is of task {stored.env!r}, not {values.get('env')!r}.")
        try:
            edited = load_config(localized(values, self.folder), STORED)
        except MorlaxError as error:
            raise MorlaxError(f"{file} does not fit: {error}") from None
        mistake = f"{file} was edited since the run began"
        remedy = f"undo that, or start a new run with --config {file}"
        check_resumable(stored, edited, mistake, remedy)
        return stored.model_copy(update={name: getattr(edited, name) for name in MAY_CHANGE})

    def limit_reached(self, config: Config) -> str | None:
        """Return the option whose limit a run resumed with `config` has reached, if any."""
        reached = checkpoint.load(self.checkpoints / "latest.pt").progress
        if not reached.evaluated:
            return None  # its last evaluation is missing
        if config.max_env_steps is not None and reached.env_steps >= config.max_env_steps:
            return "max-env-steps"
        if config.max_seconds is not None and reached.train_seconds >= config.max_seconds:
            return "max-seconds"
        return None

    def restore(self, learner: Learner) -> Progress:
        """Load the latest checkpoint, in all processes of a group, and drop later log entries."""
        first, path = learner.group.rank == 0, self.checkpoints / "latest.pt"
        if first:
            self._acquire()
        try:
            contents = checkpoint.load(path)
            mistake, remedy = "a resumed run keeps its config", "undo that, or start a new run"
            stored = load_config(_moved(contents.config, learner.config), STORED)
            check_resumable(stored, learner.config, mistake, remedy)
            other_model = checkpoint.restore(contents, path, learner)
            if first:
                self._clear_up(learner, contents)
        except BaseException:
            self._lock.release()
            raise
        evaluation = learner.config.evaluation
        before = type(evaluation).model_validate(contents.config.get("evaluation", {}))
        # other evaluations have other hypervolumes, so curves and the record of the best begin anew
        anew = other_model or before.model_copy(update={"every": evaluation.every}) != evaluation
        progress = contents.progress
        begun = {"best_selection": None, "best_hypervolume": 0.0, "series": progress.series + 1}
        return progress.model_copy(update=begun if anew else {})

    def _acquire(self) -> None:
        with attempting(f"lock {self.folder}"):
            try:
                self._lock.acquire()
            except Timeout:
                raise MorlaxError(
                    f"{self.folder} is being trained by another process: wait until it ends, or "
                    "stop it."
                ) from None

    def _clear_up(self, learner: Learner, contents: Contents) -> None:
        """Make files agree with a checkpoint: rows and drafts go, best.pt is completed."""
        evaluated = contents.progress.evaluated
        rows = read_rows(self._metrics) if self._metrics.exists() else []
        machines, machine = read_machines(self.folder), Machine.of(learner)
        last = learner.iteration if evaluated else learner.iteration - 1
        self._rows = [row for row in rows if int(row["iteration"]) <= last]
        dropped = [int(row["iteration"]) for row in rows[len(self._rows) :]]
        if dropped:
            self._write_rows()
        for iteration in dropped:
            self._front_of(iteration).unlink(missing_ok=True)
        repeats = not evaluated and learner.iteration in (0, *dropped)
        self._purge_step = learner.env_steps + (0 if repeats else 1)
        if self.has_evaluation(learner.iteration) and float(self._rows[-1].get(BEST) or 0):
            with suppress(MorlaxError):  # the front is missing or damaged
                front = Front.load(checkpoint.front_path(self.checkpoints / "latest.pt"))
                if front.fingerprint == checkpoint.fingerprint(contents.agent):
                    self._save_best(front)  # again, unless the program was killed before
        write_record(learner.config, self.folder)
        copy_files(learner.config, self.folder)
        if not machines or machines[-1] != machine:
            write_machines(self.folder, [*machines, machine])
        for folder in (self.folder, self.checkpoints, self.fronts):
            files.remove_drafts(folder)

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
            self._keep(evaluation)
        evaluated = {"evaluated": self.has_evaluation(iteration)}
        checkpoint.write(path, contents, progress.model_copy(update=evaluated))
        if evaluation is not None and evaluation.best:
            self._save_best(evaluation.front)

    def _save_best(self, front: Front) -> None:
        best = self.checkpoints / "best.pt"
        files.write_file(best, files.read(self.checkpoints / "latest.pt", "checkpoint"))
        _save_front(front, best)

    def _keep(self, evaluation: Evaluation) -> None:
        """Keep the front of the newest evaluation, and drop the one before unless it stands out."""
        files.make_folder(self.fronts)
        evaluation.front.save(self._front_of(evaluation.iteration))
        before = len(self._rows) - 2
        if before >= 0 and not milestone(before):
            self._front_of(self._rows[before]["iteration"]).unlink(missing_ok=True)

    def _front_of(self, iteration: int | str) -> Path:
        return self.fronts / f"{iteration}.npz"

    def has_evaluation(self, iteration: int) -> bool:
        return any(int(row["iteration"]) == iteration for row in self._rows)

    def log_scalars(self, scalars: Mapping[str, float], env_steps: int) -> None:
        with attempting(self._writing):
            for tag, value in scalars.items():
                self._events.add_scalar(tag, value, env_steps)

    def log_evaluation(self, evaluation: Evaluation, config: Config) -> None:
        """Write an evaluation's row and TensorBoard's values. docs/training.md lists the tags."""
        scalars = evaluation.scalars
        with attempting(self._writing):
            if not self._rows:
                self._log_hyperparameters(scalars)
            if target := config.fitting_target:
                scalars["front/hypervolume_target"] = target
            self.log_scalars(scalars, evaluation.env_steps)
            self._events.flush()
        self._rows.append(evaluation.row())
        self._write_rows()

    def _write_rows(self) -> None:
        if not self._rows:
            self._metrics.unlink(missing_ok=True)
            return
        columns = dict.fromkeys(chain(self._rows[-1], *self._rows))
        rows = ([row.get(column, "") for column in columns] for row in self._rows)
        files.write_rows(self._metrics, [list(columns), *rows])

    @cached_property
    def _events(self) -> "SummaryWriter":
        from torch.utils.tensorboard import SummaryWriter

        writer = SummaryWriter(str(self.folder), purge_step=self._purge_step)
        for file in ("config.yaml", HARDWARE):
            lines = (self.folder / file).read_text().splitlines()
            tag, text = file.removesuffix(".yaml"), "\n".join(f"    {line}" for line in lines)
            writer.add_text(tag, text)
        writer.add_custom_scalars({"front": {"hypervolume": ["Multiline", ["front/"]]}})
        return writer

    def draw(self, front: Front, config: Config, env_steps: int) -> None:
        """Write pictures of the latest evaluation to TensorBoard, if it is a `milestone`."""
        if not milestone(len(self._rows) - 1):
            return
        from ..evaluation import figures

        name = f"{title(config.env)} after {env_steps / 1e6:.1f} M steps"
        with attempting(self._writing):
            for tag, draw in (("front", figures.front_figure), ("returns", figures.returns_figure)):
                image = figures.pixels(draw(front, name))
                self._events.add_image(f"views/{tag}", image, env_steps, dataformats="HWC")

    def _log_hyperparameters(self, tags: Iterable[str]) -> None:
        """Fill the HPARAMS tab, first with options that differ from the task's config."""
        from torch.utils.tensorboard.summary import hparams

        values = read_yaml(self.folder / "config.yaml")
        first = changed(values)
        ordered = sorted(flat(values).items(), key=lambda item: item[0] not in first)
        config = {name: _shown(value) for name, value in ordered if value != {}}
        # `add_hparams` would write to a folder of its own, which TensorBoard shows as another run
        experiment, session, _ = hparams(config, dict.fromkeys(tags, 0.0))
        assert self._events.file_writer is not None
        for summary in (experiment, session):
            self._events.file_writer.add_summary(summary)

    def close(self) -> None:
        """Write and close the TensorBoard events, and let other processes train the run."""
        try:
            with attempting(self._writing):
                self._events.close()
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


def load_libraries() -> None:
    """Import what a `Run` imports late, because it loads slowly."""
    import_module(".evaluation.figures", "morlax_torch")
    import_module("torch.utils.tensorboard")


def milestone(number: int) -> bool:
    """Return whether a run keeps pictures and the front of an evaluation, by its number from 0.

    After the first ten, each is a tenth later than the one before, so that a long run stays small.
    """
    scales = [int(math.log(max(1, each), 1.1)) for each in (number - 1, number)]
    return number < 10 or scales[0] < scales[1]


def is_training(folder: Path) -> bool:
    """Return whether a process trains the run in a folder."""
    try:
        if (folder / LOCK).exists():
            FileLock(folder / LOCK, timeout=0).acquire().lock.release()
    except OSError as error:  # or it is another user's run, which cannot be locked
        return isinstance(error, Timeout)
    return False


def _moved(values: dict[str, Any], config: Config) -> dict[str, Any]:
    """Return a config's values with the code that `config` names, wherever it lies now."""
    names = {field: getattr(config, field) for field in NAMES_CODE}
    return values | {
        field: name
        for field, name in names.items()
        if movable(str(values.get(field))) == movable(name)
    }


def _save_front(front: Front, path: Path) -> None:
    front._replace(checkpoint=path.name).save(checkpoint.front_path(path))


def _shown(value: Any) -> str | float:
    """Return a finite number or text as it is, other values as JSON."""
    plain = isinstance(value, str) or (type(value) in (int, float) and math.isfinite(value))
    return value if plain else json.dumps(value)
