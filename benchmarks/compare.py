"""Compare methods: train tasks x methods x seeds, then make tables and figures.

    python benchmarks/compare.py --tasks cheetah hopper --methods methods.yaml --seconds 60

methods.yaml maps the name of a method to changes of the task's config, see compare_methods.yaml.
Every run has a folder, OUTPUT/TASK/METHOD/SEED. Killed and started again, the command trains what
is missing. A run that crashed counts as done: remove its folder to train it again.

Several GPUs take a share of the runs each, with one process per GPU:

    CUDA_VISIBLE_DEVICES=0 python benchmarks/compare.py --share 0/2 &
    CUDA_VISIBLE_DEVICES=1 python benchmarks/compare.py --share 1/2

Writes OUTPUT/rows.csv, one row per evaluation, OUTPUT/results.md, the tables, and figures: curves
of the hypervolume, a performance profile, and interquartile means. To make the tables and figures
again from rows.csv alone:

    python benchmarks/compare.py --output comparison --only-report
"""

import csv
import gc
import importlib
import io
import itertools
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro
import yaml
from compare_report import report
from comparing import scaled_igd_plus
from filelock import FileLock, Timeout

from morlax_torch import MorlaxError, config_for, pareto
from morlax_torch.config import Config
from morlax_torch.config_files import read_yaml
from morlax_torch.envs import resolve_device
from morlax_torch.envs.naming import title
from morlax_torch.evaluation.front import Front, hypervolume_in
from morlax_torch.evaluation.history import read_rows
from morlax_torch.files import replacing
from morlax_torch.reports.comparison import union
from morlax_torch.runs.progress import Evaluation
from morlax_torch.terminal.cli import console, fail

METHODS = Path(__file__).with_name("compare_methods.yaml")
OURS = ("env", "seed", "device", "max_seconds")  # options that the command sets
OUTCOME, BEST_FRONT = "outcome.yaml", "best_front.npz"  # in the folder of a run
COLUMNS = (
    *("task", "method", "oracle", "seed", "env_steps", "train_seconds", "total_seconds"),
    *("hypervolume", "expected_utility", "sparsity", "obedience", "cardinality"),
    *("fall_rate", "blowup_rate", "steps_per_second", "blowups"),
    *("igd_plus", "oracle_hypervolume", "error"),
)


class Method(NamedTuple):
    """A method to compare."""

    name: str
    changes: dict[str, Any]  # of a task's config, for `config_for`
    seconds: float  # of training
    oracle: bool  # whether its fronts are the reference of the other methods
    trainer: str | None = None  # a module beside this one, whose `train` it uses


class Job(NamedTuple):
    """A run to train."""

    task: str
    method: Method
    seed: int

    def __str__(self) -> str:
        return f"{self.task}, {self.method.name}, seed {self.seed}"

    def folder(self, output: Path) -> Path:
        """Return the folder of the run."""
        return output / title(self.task) / self.method.name / str(self.seed)

    def config(self, device: str) -> Config:
        """Return the config of the run.

        Raises:
            MorlaxError: the method's changes do not fit the task.
        """
        own = {"seed": self.seed, "device": device, "max_seconds": self.method.seconds}
        unlimited = {"max_env_steps": None}  # so that learning rates reach zero when time is over
        try:
            return config_for(self.task, **{**unlimited, **self.method.changes, **own})
        except MorlaxError as error:
            raise MorlaxError(f"{self}: {error}") from None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that a complete run must agree with."""
        return {
            "task": self.task,
            "seconds": self.method.seconds,
            "changes": self.method.changes,
        }


def main(
    output: Path = Path("comparison"),
    tasks: tuple[str, ...] = ("cheetah", "hopper", "walker", "ant", "humanoid"),
    methods: Path = METHODS,
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4),
    seconds: float = 60.0,
    share: str = "0/1",
    device: str | None = None,
    only_report: bool = False,
) -> None:
    """Train the runs that are missing, and report all that are complete.

    Args:
        output: Folder of the runs, tables and figures.
        tasks: Tasks to train.
        methods: YAML file of methods.
        seeds: Random seeds, one run of each task and method per seed.
        seconds: Training time per run, in seconds, of methods without their own.
        share: Train every N-th run from the K-th on, as K/N, with K from 0.
        device: cuda or cpu (None: CUDA if available).
        only_report: Train nothing, and read OUTPUT/rows.csv alone.
    """
    if only_report:
        console.print(report(output), markup=False)
        return
    place = str(resolve_device(device))
    jobs = plan(tasks, read_methods(methods, seconds), seeds)
    missing = [job for job in jobs if not is_complete(job, output)]
    for job in missing:
        job.config(place)  # so that a mistake in a method ends the command here
    own = [job for job in shared(jobs, share) if job in missing]
    for number, job in enumerate(own, start=1):
        console.print(f"{number}/{len(own)}: {job}", markup=False)
        train_once(job, output, place)
    # else a slower process would replace the report of all runs with an older one
    with FileLock(output / ".report.lock"):
        write_rows(gather(jobs, output), output / "rows.csv")
        console.print(report(output), markup=False)


def read_methods(path: Path, seconds: float) -> list[Method]:
    """Read the methods of a YAML file; `seconds` is the training time of those without their own.

    Raises:
        MorlaxError: the file cannot be read, a method is not valid, or two are oracles.
    """
    methods = [_method(name, values, seconds) for name, values in read_yaml(path).items()]
    if not methods:
        raise MorlaxError(f"{path} has no method: add a line such as MORLAX: {{}}.")
    oracles = [method.name for method in methods if method.oracle]
    if len(oracles) > 1:
        raise MorlaxError(f"{' and '.join(oracles)} are oracles: only one method can be.")
    return methods


def _method(name: Any, values: Any, seconds: float) -> Method:
    if not isinstance(name, str) or "/" in name or name.startswith("."):
        raise MorlaxError(
            f"the method {name!r} cannot name a folder: use a name without / or a dot in front."
        )
    if values is not None and not isinstance(values, dict):
        raise MorlaxError(f"the method {name} must hold changes, such as {{network.type: single}}.")
    changes = dict(values or {})
    own, oracle = changes.pop("seconds", seconds), changes.pop("oracle", False)
    if isinstance(own, bool) or not isinstance(own, int | float) or not 0 < own < math.inf:
        raise MorlaxError(f"seconds of the method {name} must be a positive number, not {own!r}.")
    if not isinstance(oracle, bool):
        raise MorlaxError(f"oracle of the method {name} must be true or false, not {oracle!r}.")
    trainer = changes.pop("trainer", None)
    if trainer is not None and not Path(__file__).with_name(f"{trainer}.py").is_file():
        raise MorlaxError(f"trainer of the method {name} must be a module of this folder.")
    taken = [key for key in changes if key in OURS]
    if taken:
        raise MorlaxError(f"the method {name} cannot change {taken[0]}, which the command sets.")
    return Method(name, changes, float(own), oracle, trainer)


def plan(tasks: Sequence[str], methods: Sequence[Method], seeds: Sequence[int]) -> list[Job]:
    """Return all runs, in the order of tables."""
    every = itertools.product(dict.fromkeys(tasks), methods, dict.fromkeys(seeds))
    return [Job(*one) for one in every]


def shared(items: Sequence[Any], share: str) -> list[Any]:
    """Return the K-th of N shares of items, with `share` as K/N.

    It depends on nothing else, so that processes that start at different times agree.

    Raises:
        MorlaxError: `share` is not K/N, with K from 0 to N - 1.
    """
    first, _, number = share.partition("/")
    if not (first.isdecimal() and number.isdecimal() and int(first) < int(number)):
        raise MorlaxError(f"the share {share!r} must be K/N with K from 0 to N - 1, such as 0/4.")
    return list(items[int(first) :: int(number)])


def is_complete(job: Job, output: Path) -> bool:
    """Return whether a run has ended, by itself or in a crash.

    Raises:
        MorlaxError: it was trained with other settings.
    """
    path = job.folder(output) / OUTCOME
    if not path.is_file():
        return False
    found = read_yaml(path)
    for name, value in job.settings.items():
        if found.get(name) != value:
            raise MorlaxError(
                f"{path.parent} was trained with {name} {found.get(name)}, not {value}: choose "
                "another --output, or remove that folder to train the run again."
            )
    return True


def train_once(job: Job, output: Path, device: str) -> None:
    """Train a run, unless another process does so or has done so."""
    folder = job.folder(output)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder.with_name(f".{folder.name}.lock"), timeout=0):
            if not is_complete(job, output):
                _train(job, folder, device)
    except Timeout:
        console.print(f"another process trains {job}", markup=False)


def _train(job: Job, folder: Path, device: str) -> None:
    """Train a run from its beginning, and write its outcome last."""
    if folder.exists():
        shutil.rmtree(folder)
    gc.collect()  # the last run's learner holds GPU memory in reference cycles
    error, config = None, job.config(device)
    try:
        trainer = importlib.import_module(job.method.trainer or "morlax_torch.train")
        trainer.train(config, output=folder, on_evaluation=_keep_best(folder))
    except MorlaxError as caught:
        error = str(caught)
        console.print(f"{job} crashed: {error}", markup=False)
    folder.mkdir(exist_ok=True)
    with replacing(folder / OUTCOME) as file:
        file.write(yaml.safe_dump({**job.settings, "error": error}, sort_keys=False).encode())


def _keep_best(folder: Path) -> Callable[[Evaluation], None]:
    """Return a function that keeps the front of the highest hypervolume in a file."""
    best = -math.inf

    def keep(evaluation: Evaluation) -> None:
        nonlocal best
        if evaluation.hypervolume > best:
            best = evaluation.hypervolume
            evaluation.front.save(folder / BEST_FRONT)

    return keep


def gather(jobs: Sequence[Job], output: Path) -> list[dict[str, Any]]:
    """Return a row for every evaluation and every crash of the complete runs.

    Raises:
        MorlaxError: a file is damaged, or the fronts of a task cannot be compared.
    """
    done = [job for job in jobs if is_complete(job, output)]
    rows = []
    for _, group in itertools.groupby(done, key=lambda job: job.task):
        own = list(group)
        paths = {str(job): job.folder(output) / BEST_FRONT for job in own}
        fronts = {name: Front.load(path) for name, path in paths.items() if path.is_file()}
        _check_comparable(fronts)
        reference, volume = _reference(
            [fronts[str(job)] for job in own if job.method.oracle and str(job) in fronts]
        )
        for job in own:
            rows += _rows(job, output, fronts.get(str(job)), reference, volume)
    return rows


def _check_comparable(fronts: Mapping[str, Front]) -> None:
    """Raise MorlaxError if fronts differ in their objectives or in their reference point."""
    for (one, first), (other, second) in itertools.pairwise(fronts.items()):
        same = np.array_equal(first.reference_point, second.reference_point)
        if first.objectives != second.objectives or not same:
            raise MorlaxError(
                f"{one} and {other} differ in their objectives or in the reference point, so their "
                "hypervolumes cannot be compared."
            )


def _reference(fronts: Sequence[Front]) -> tuple[np.ndarray | None, float | None]:
    """Return the union (n, m) of the oracle's fronts and its hypervolume, or None without any."""
    if not fronts:
        return None, None
    points = union(fronts)
    volume = pareto.hypervolume(points, fronts[0].reference_point)
    return (points, volume) if volume > 0 else (None, None)


def _rows(
    job: Job,
    output: Path,
    front: Front | None,
    reference: np.ndarray | None,
    volume: float | None,
) -> list[dict[str, Any]]:
    """Return a row for every evaluation of a run, and one for its crash.

    IGD+ is in the row of the highest hypervolume, because only that front is kept.
    """
    folder, method = job.folder(output), job.method
    shared_cells = {
        "task": job.task,
        "method": method.name,
        "oracle": int(method.oracle),
        "seed": job.seed,
        "oracle_hypervolume": volume,
    }
    metrics = folder / "metrics.csv"
    found = read_rows(metrics) if metrics.is_file() else []
    rows = [
        {**row, "hypervolume": row[hypervolume_in(row)], **shared_cells, "error": ""}
        for row in found
    ]
    if front is not None and reference is not None:
        best = max(rows, key=lambda row: float(row["hypervolume"]))
        best["igd_plus"] = scaled_igd_plus(front.returns, reference)
    error = read_yaml(folder / OUTCOME)["error"]
    if error is not None:
        rows.append({**shared_cells, "error": error})
    return rows


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a CSV file with COLUMNS.

    Raises:
        MorlaxError: there are no rows, or the file cannot be written.
    """
    if not rows:
        raise MorlaxError("no run is complete yet, so there is nothing to report.")
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    with replacing(path) as file:
        file.write(text.getvalue().encode())


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except MorlaxError as error:
        fail(str(error))
