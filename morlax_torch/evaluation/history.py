"""The evaluations of a run during training, as its metrics.csv holds them."""

import csv
import io
import math
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from ..files import AnyPath, read
from .front import hypervolume_in

COUNTERS = ("iteration", "env_steps", "train_seconds")  # what every row needs, with a hypervolume


class History(NamedTuple):
    """Training curves with one value per evaluation, E in all."""

    env_steps: np.ndarray  # (E,)
    train_seconds: np.ndarray  # (E,) wall-clock time of rollouts and updates only
    hypervolume: np.ndarray  # (E,)

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a run's metrics.csv; the hypervolume is exact or approximate, as in the file.

        Raises:
            MorlaxError: the file cannot be read, or is damaged.
        """
        rows = read_rows(path)
        columns = (*COUNTERS[1:], hypervolume_in(rows[0]))
        return cls(*(np.array([float(row[name]) for row in rows]) for name in columns))


def read_rows(path: AnyPath) -> list[dict[str, str]]:
    """Read the rows of a run's metrics.csv, at least one, each with finite numbers.

    Raises:
        MorlaxError: the file cannot be read, or is damaged.
    """
    text = read(path, "training curve").decode(errors="replace")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
        needed = (*COUNTERS, hypervolume_in(rows[0]))
        for row in rows:
            _check(row, needed)
    except (csv.Error, IndexError, KeyError, StopIteration, TypeError, ValueError):
        raise MorlaxError(
            f"{path} is damaged: it needs a row for each evaluation of a run, with "
            f"{', '.join(COUNTERS)} and hypervolume, and every cell must be a finite number."
        ) from None
    return rows


def _check(row: dict[str, str], needed: tuple[str, ...]) -> None:
    """Raise an error unless every cell is a finite number, or empty if it is not needed."""
    for name, cell in row.items():
        if cell == "" and name not in needed:
            continue  # a column that is newer than the row
        if not math.isfinite(float(cell)):
            raise ValueError
    if int(row["iteration"]) < 0 or min(float(row[name]) for name in COUNTERS) < 0:
        raise ValueError
