"""Trade-offs over the time of an episode: weights at knots, linear in between."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import yaml

from ..envs import MorlaxError
from ..host.files import write_file
from .files import read_yaml


class Schedule(NamedTuple):
    """A trade-off that changes with the time of an episode, or several."""

    times: np.ndarray  # (k,) s, of the knots
    weights: np.ndarray  # (..., k, m)
    name: str = ""

    def at(self, seconds: float) -> np.ndarray:
        """Return the trade-off (..., m) of a time; outside all knots, that of the nearest."""
        shares = [np.interp(seconds, self.times, knot) for knot in np.eye(len(self.times))]
        return np.tensordot(self.weights, shares, (-2, 0))

    def save(self, file: Path, objectives: Sequence[str]) -> None:
        weights = dict(zip(objectives, self.weights.T.tolist(), strict=True))
        values = {"name": self.name, "times": self.times.tolist(), "weights": weights}
        write_file(file, yaml.safe_dump(values, default_flow_style=None, sort_keys=False))

    @classmethod
    def load(cls, file: str, objectives: Sequence[str]) -> Self:
        """Read a file that `save` wrote, or raise MorlaxError."""
        values = read_yaml(file, "trade-off over time", "times: [0, 2.5, 5]")
        try:
            times, rows = np.array(values["times"], float), dict(values["weights"])
            weights = np.array([rows.pop(name) for name in objectives], float).T
            valid = not rows and len(times) == len(weights) >= 2 and (np.diff(times) > 0).all()
            valid &= bool(np.isfinite(weights).all() and (weights >= 0).all())
            valid &= bool(weights.any(1).all() and np.isfinite(times).all())
        except (KeyError, TypeError, ValueError):
            valid = False
        if not valid:
            raise MorlaxError(
                f"{file} is no trade-off over time: it needs `times`, two or more rising seconds, "
                f"and `weights`, as many for each of {', '.join(objectives)}."
            )
        return cls(times, weights / weights.sum(1, keepdims=True), str(values.get("name", "")))
