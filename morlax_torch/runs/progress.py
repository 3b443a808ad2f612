"""Progress of a run: counters, and evaluations as metrics.csv holds them."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..envs import MorlaxError
from ..evaluation.front import Front, hypervolume_in
from ..host.files import AnyPath, read
from ..host.torchrun import launch

FRONTS = "fronts"  # folder in that of a run
Kept = dict[Path, tuple[float, float, float]]  # env_steps, train_seconds, hypervolume by file
BEST = "best"  # column: 1 if the checkpoint of the evaluation became best.pt, else 0
PROTOCOL = "protocol"  # column: how returns were counted, the only one that is text
SERIES = "series"  # column: see `Progress`
COUNTERS = ("iteration", "env_steps", "train_seconds")  # what every row needs, with a hypervolume


class Evaluation(NamedTuple):
    """One evaluation during training."""

    iteration: int
    env_steps: int
    train_seconds: float  # exploring and learning only
    total_seconds: float  # since the command began, over all sessions of the run
    steps_per_second: float  # environment steps per second of training, just before
    blowups: int  # how often a training world left sane bounds so far
    front: Front
    indicators: dict[str, float]  # by name
    selection: dict[str, float] | None = None  # of the episodes that choose; None: the same
    best: bool = False  # whether its checkpoint became best.pt
    series: int = 0  # see `Progress`

    @property
    def hypervolume(self) -> float:
        return self.indicators[hypervolume_in(self.indicators)]

    @property
    def scalars(self) -> dict[str, float]:
        """The values by TensorBoard's tag; it shows tags by their names, the hypervolume first."""
        volume = hypervolume_in(self.indicators)
        return {
            f"front/{volume}": self.hypervolume,
            **{f"indicators/{k}": value for k, value in self.indicators.items() if k != volume},
            "time/train_seconds": self.train_seconds,
            "time/total_seconds": self.total_seconds,
        }

    @property
    def selection_hypervolume(self) -> float:
        """The hypervolume that the best checkpoint is chosen by."""
        indicators = self.indicators if self.selection is None else self.selection
        return indicators[hypervolume_in(indicators)]

    def row(self) -> dict[str, Any]:
        return {
            "iteration": self.iteration,
            "env_steps": self.env_steps,
            "train_seconds": round(self.train_seconds, 3),
            "total_seconds": round(self.total_seconds, 3),
            **self.indicators,
            "steps_per_second": round(self.steps_per_second),
            "blowups": self.blowups,
            BEST: int(self.best),
            PROTOCOL: self.front.protocol,
            SERIES: self.series,
        }


class Progress(BaseModel):
    """A run's counters, updated in place while it trains and saved in checkpoints."""

    model_config = ConfigDict(allow_inf_nan=False)

    env_steps: int = 0
    processes: int = 1  # that trained together last
    launch: str = Field(default_factory=launch)  # of `torchrun`, that trained last
    train_seconds: float = 0.0  # exploring and learning, without compiling, evaluating and saving
    total_seconds: float = 0.0  # since the command began, over all sessions of the run
    steps_per_second: float = 0.0
    blowups: int = 0  # how often a training world left sane bounds
    hypervolume: float = 0.0  # of the latest evaluation, as reported
    best_hypervolume: float = 0.0  # of best.pt, as reported
    best_selection: float | None = None  # on the episodes that choose; None: the next one is best
    series: int = 0  # of evaluations that compare: a resume that evaluates otherwise begins another
    evaluated: bool = True  # whether metrics.csv has the row of the checkpoint

    def improved(self, selection: float, hypervolume: float) -> bool:
        """Store the hypervolumes of an evaluation; returns whether it is the best so far."""
        self.hypervolume = hypervolume
        # of equals, such as fronts below the reference point, the later one was trained longer
        best = self.best_selection is None or selection >= self.best_selection
        if best:
            self.best_selection, self.best_hypervolume = selection, hypervolume
        return best


class History(NamedTuple):
    """Training curves with one value per evaluation that compares with the last, (E,)."""

    env_steps: np.ndarray
    train_seconds: np.ndarray
    hypervolume: np.ndarray

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a run's metrics.csv; each hypervolume is exact or approximate, as in its row."""
        rows = comparable(read_rows(path))
        values = [[*(float(row[n]) for n in COUNTERS[1:]), hypervolume_of(row)] for row in rows]
        return cls(*np.transpose(values))


def kept_fronts(run: Path) -> Kept:
    """Return the fronts that a run has kept, in order: of its growth, best.pt and the newest."""
    rows = comparable(read_rows(run / "metrics.csv")) if (run / FRONTS).is_dir() else []
    files = [run / FRONTS / f"{row['iteration']}.npz" for row in rows]
    best = best_row(rows)
    if rows and not files[best].is_file():
        files[best] = run / "front.npz"
    return {
        file: (float(row["env_steps"]), float(row["train_seconds"]), hypervolume_of(row))
        for file, row in zip(files, rows, strict=True)
        if file.is_file()
    }


def comparable(rows: Sequence[dict[str, str]]) -> list[dict[str, str]]:
    """Return the evaluations of the last one's series."""
    numbers = [float(row.get(SERIES) or 0) for row in rows]  # none: of an earlier version
    return [row for row, number in zip(rows, numbers, strict=True) if number == numbers[-1]]


def read_rows(path: AnyPath) -> list[dict[str, str]]:
    """Read the rows of a run's metrics.csv, at least one, each with finite numbers."""
    text = read(path, "training curve").decode(errors="replace")
    try:
        rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
        if not rows:
            raise ValueError
        for row in rows:  # cells are finite, or empty because their column is newer
            counters = [int(row["iteration"]), *(float(row[name]) for name in COUNTERS[1:])]
            numbers = {k: cell for k, cell in row.items() if cell != "" and k != PROTOCOL}
            cells = [hypervolume_of(row), *map(float, numbers.values())]
            if min(counters) < 0 or not all(map(math.isfinite, cells)):
                raise ValueError
    except (csv.Error, KeyError, StopIteration, TypeError, ValueError):
        raise MorlaxError(
            f"{path} is damaged: it needs a row for each evaluation of a run, with "
            f"{', '.join(COUNTERS)} and hypervolume, and all cells must be finite numbers, except "
            "the protocol."
        ) from None
    return rows


def hypervolume_of(row: Mapping[str, str]) -> float:
    """Return the hypervolume of a row, exact or approximate."""
    # a resumed run with another number of trade-offs may have both columns, one of them empty
    return float(row[hypervolume_in(name for name, cell in row.items() if cell != "")])


def best_row(rows: Sequence[Mapping[str, str]]) -> int:
    """Return the index of the evaluation that best.pt was saved at: the last one with a mark."""
    return max((i for i, row in enumerate(rows) if float(row.get(BEST) or 0)), default=0)
