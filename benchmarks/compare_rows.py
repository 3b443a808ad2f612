"""The rows of a comparison: every evaluation, outcome and crash of its runs, as a CSV file."""

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from compare_jobs import FRONT, OUTCOME, Job, is_complete
from compare_statistics import scaled_igd_plus

from morlax_torch import MorlaxError, pareto
from morlax_torch.configuration.files import read_yaml
from morlax_torch.evaluation.front import Front
from morlax_torch.host.files import write_file
from morlax_torch.reports.comparison import union
from morlax_torch.runs.progress import hypervolume_of, read_rows

COLUMNS = (
    *("task", "method", "reference", "seed", "fresh"),
    *("env_steps", "train_seconds", "total_seconds"),
    *("hypervolume", "expected_utility", "sparsity", "obedience", "cardinality"),
    *("fall_rate", "blowup_rate", "steps_per_second", "blowups"),
    *("igd_plus", "reference_hypervolume", "error"),
)


def gather(jobs: Sequence[Job], output: Path) -> list[dict[str, Any]]:
    """Return a row for every evaluation, chosen checkpoint and crash of the complete runs.

    Raises:
        MorlaxError: a file is damaged, or the fronts of a task cannot be compared.
    """
    done = [job for job in jobs if is_complete(job, output)]
    rows = []
    for _, group in itertools.groupby(done, key=lambda job: job.task):
        own = list(group)
        paths = {str(job): job.folder(output) / FRONT for job in own}
        fronts = {name: Front.load(path) for name, path in paths.items() if path.is_file()}
        _check_comparable(fronts)
        reference, volume = _reference(
            [fronts[str(job)] for job in own if job.method.reference and str(job) in fronts]
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
    """Return the union (n, m) of the reference's fronts and its hypervolume; None without any."""
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
    """Return a row for every evaluation of a run, one for its chosen checkpoint, one for its crash.

    The row of the chosen checkpoint, which is `fresh`, has the indicators of its `front`.
    """
    folder, method = job.folder(output), job.method
    shared_cells = {
        "task": job.task,
        "method": method.name,
        "reference": int(method.reference),
        "seed": job.seed,
        "reference_hypervolume": volume,
    }
    metrics = folder / "metrics.csv"
    found = read_rows(metrics) if metrics.is_file() else []
    rows = [
        {**row, "hypervolume": hypervolume_of(row), **shared_cells, "fresh": 0} for row in found
    ]
    if front is not None:
        found = {**front.indicators(), "hypervolume": front.hypervolume}
        if reference is not None:
            found["igd_plus"] = scaled_igd_plus(front.returns, reference)
        rows.append({**found, **shared_cells, "fresh": 1})
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
    write_file(path, text.getvalue())
