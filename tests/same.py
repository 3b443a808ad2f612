"""Equality of nested states, rows of CSV files, and reference trajectories."""

import csv
from pathlib import Path

import numpy as np
from torch import Tensor, equal

from morlax_torch.runs import Run


def assert_same(one: object, other: object) -> None:
    """Equal to the last bit, however nested."""
    if isinstance(one, Tensor):
        assert isinstance(other, Tensor) and equal(one, other)
    elif isinstance(one, dict):
        assert isinstance(other, dict) and one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, list):
        assert isinstance(other, list)
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
    else:
        assert one == other


def csv_rows(path: Path | str) -> list[dict[str, str]]:
    with Path(path).open(newline="") as file:
        return list(csv.DictReader(file))


def rows_of(run: Run) -> list[dict[str, str]]:
    """Return what metrics.csv of a run holds: nothing before its first evaluation."""
    file = run.folder / "metrics.csv"
    return csv_rows(file) if file.exists() else []


def reference(robot: str) -> dict[str, np.ndarray]:
    """Return the arrays of a published robot: see reference/README.md."""
    with np.load(Path(__file__).with_name("reference") / f"{robot}.npz") as file:
        return dict(file)
