"""The evaluations that a run made while it trained."""

import csv
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from .front import hypervolume_in


class History(NamedTuple):
    """A row for each evaluation."""

    env_steps: np.ndarray  # (E,)
    train_seconds: np.ndarray  # (E,)
    hypervolume: np.ndarray  # (E,)

    @classmethod
    def load(cls, path: Path) -> Self:
        """The curves of a metrics.csv, exact or approximate hypervolume.

        Raises:
            MorlaxError: it cannot be read, or holds something else.
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
                f"{path} is damaged: it should have a row for each evaluation of a run, with "
                "env_steps, train_seconds and hypervolume."
            ) from None
