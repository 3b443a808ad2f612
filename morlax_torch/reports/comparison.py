"""Several evaluated runs beside each other: their names, whether they compare, their quartiles."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..envs import MorlaxError
from ..evaluation import pareto
from ..evaluation.front import Front
from ..networks.policy import Policy
from ..runs.loading import find_run

SAME = ("objectives", "shared", "episode_length", "reference_point", "reset_noise")


class Quartiles(NamedTuple):
    """Of one indicator over runs."""

    low: float
    median: float
    high: float


def names(runs: Sequence[str | os.PathLike[str]]) -> list[str]:
    """A name for each run: the end of its path, as much as tells it from the others.

    A checkpoint is called by its run and itself, as in `20261120-054533-0-latest`.

    Raises:
        MorlaxError: one is given twice.
    """
    paths = []
    for run in runs:
        folder, file = find_run(run).resolve(), Path(run)
        paths.append(folder.with_name(f"{folder.name}-{file.stem}") if file.is_file() else folder)
        if paths.index(paths[-1]) < len(paths) - 1:
            raise MorlaxError(f"{run} is given twice: name each run once.")
    parts = [path.parts[1:] for path in paths]  # what is called "/" could lead anywhere
    for depth in range(1, 2 + max(map(len, parts))):
        found = ["/".join(some[-depth:]) for some in parts]
        if len(set(found)) == len(found):
            break
    return found


def check_comparable(policies: Mapping[str, Policy]) -> None:
    """Raise MorlaxError if the returns of some policies, by name, cannot be compared."""
    (first, one), *others = policies.items()
    for name, other in others:
        if one.config.env != other.config.env:
            raise MorlaxError(
                f"{first} is of task {one.config.env!r} and {name} of {other.config.env!r}: only "
                "runs of one task can be compared."
            )
        if one.objectives != other.objectives:
            raise MorlaxError(
                f"{first} trades off {', '.join(one.objectives)} and {name} "
                f"{', '.join(other.objectives)}: only runs of the same objectives can be compared."
            )
        mine, theirs = one.config.task.model_dump(), other.config.task.model_dump()
        for option in SAME:
            if mine[option] != theirs[option]:
                raise MorlaxError(
                    f"{first} and {name} differ in task.{option} ({mine[option]} and "
                    f"{theirs[option]}), so their returns cannot be compared: evaluate them apart."
                )


def union(fronts: Sequence[Front]) -> np.ndarray:
    """The non-dominated points (n, m) of all fronts together."""
    return pareto.front(np.concatenate([front.returns for front in fronts]))


def measures(front: Front, reference_front: np.ndarray | None) -> dict[str, float]:
    """Indicators, the mean episode length, and the range of every objective's returns, by name."""
    found = front.indicators(reference_front)
    found["episode_length"] = float(front.lengths.mean())
    for name, returns in zip(front.objectives, front.returns.T, strict=True):
        found[f"{name}_min"] = float(returns.min())
        found[f"{name}_max"] = float(returns.max())
    return found


def quartiles(measured: Sequence[Mapping[str, float]]) -> dict[str, Quartiles]:
    """Of every measure, over runs; between runs they are interpolated linearly."""
    return {
        name: Quartiles(*np.quantile([m[name] for m in measured], (0.25, 0.5, 0.75)).tolist())
        for name in measured[0]
    }
