"""The evaluations of a run during training."""

import csv
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from .front import hypervolume_in


class History(NamedTuple):
    """Training curves with one value per evaluation, E in all."""

    env_steps: np.ndarray  # (E,)
    train_seconds: np.ndarray  # (E,) wall-clock time of rollouts and updates only
    hypervolume: np.ndarray  # (E,)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a run's metrics.csv; the hypervolume is exact or approximate, as in the file.

        Raises:
            MorlaxError: the file cannot be read, or is damaged.
        """
        try:
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            volume = hypervolume_in(rows[0])
            columns = ("env_steps", "train_seconds", volume)
            return cls(*(np.array([float(row[c]) for row in rows]) for c in columns))
        except OSError as error:
            raise MorlaxError(f"cannot read {path}: {error.strerror}.") from None
        except (IndexError, KeyError, StopIteration, TypeError, ValueError):
            raise MorlaxError(
                f"{path} is damaged: it needs a row for each evaluation of a run, with env_steps, "
                "train_seconds and hypervolume."
            ) from None
