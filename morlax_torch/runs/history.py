"""The evaluations of a run during training, as its metrics.csv holds them."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from ..evaluation.front import hypervolume_in
from ..host.files import AnyPath, read

BEST = "best"  # column: 1 if the checkpoint of the evaluation became best.pt, else 0
COUNTERS = ("iteration", "env_steps", "train_seconds")  # what every row needs, with a hypervolume


class History(NamedTuple):
    """Training curves with one value per evaluation, E in all."""

    env_steps: np.ndarray  # (E,)
    train_seconds: np.ndarray  # (E,) wall-clock time of rollouts and updates only
    hypervolume: np.ndarray  # (E,)

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a run's metrics.csv; each hypervolume is exact or approximate, as in its row.

        Raises:
            MorlaxError: the file cannot be read, or is damaged.
        """
        rows = read_rows(path)
        env_steps, train_seconds = (
            np.array([float(row[name]) for row in rows]) for name in COUNTERS[1:]
        )
        return cls(env_steps, train_seconds, np.array([hypervolume_of(row) for row in rows]))


def read_rows(path: AnyPath) -> list[dict[str, str]]:
    """Read the rows of a run's metrics.csv, at least one, each with finite numbers.

    Raises:
        MorlaxError: the file cannot be read, or is damaged.
    """
    text = read(path, "training curve").decode(errors="replace")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
        if not rows:
            raise ValueError
        for row in rows:
            _check(row)
    except (csv.Error, KeyError, StopIteration, TypeError, ValueError):
        raise MorlaxError(
            f"{path} is damaged: it needs a row for each evaluation of a run, with "
            f"{', '.join(COUNTERS)} and hypervolume, and every cell must be a finite number."
        ) from None
    return rows


def hypervolume_of(row: Mapping[str, str]) -> float:
    """Return the hypervolume of a row, exact or approximate.

    A resumed run that evaluates another number of trade-offs may have both columns, and in each row
    one of them is empty.
    """
    return float(row[hypervolume_in(name for name, cell in row.items() if cell != "")])


def best_row(rows: Sequence[Mapping[str, str]]) -> int:
    """Return the index of the evaluation that best.pt was saved at.

    Without a mark, it is the first one with the highest hypervolume.
    """
    marked = [index for index, row in enumerate(rows) if float(row.get(BEST) or 0)]
    return marked[-1] if marked else int(np.argmax([hypervolume_of(row) for row in rows]))


def _check(row: dict[str, str]) -> None:
    """Raise an error unless every cell is a finite number, or empty if it is not needed."""
    needed = (*COUNTERS, hypervolume_in(name for name, cell in row.items() if cell != ""))
    for name, cell in row.items():
        if cell == "" and name not in needed:
            continue  # a column that is newer than the row
        if not math.isfinite(float(cell)):
            raise ValueError
    if int(row["iteration"]) < 0 or min(float(row[name]) for name in COUNTERS) < 0:
        raise ValueError
