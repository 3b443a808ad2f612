"""Compare evaluated runs: short names, comparability, quartiles."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..configuration.sections import Protocol
from ..envs import MorlaxError
from ..envs.naming import movable
from ..evaluation import pareto
from ..evaluation.front import Front
from ..host.files import AnyPath, read
from ..networks.policy import Policy
from ..runs.hardware import Machine
from ..runs.loading import find_run
from ..runs.progress import History

BUFFERS = {"nconmax", "njmax"}  # task options that do not change returns


class Evaluated(NamedTuple):
    """A run and its evaluation."""

    path: str  # as given on the command line
    policy: Policy
    front: Front
    history: History | None  # of training; None: unknown
    measures: dict[str, float]
    machines: Sequence[Machine] = ()  # that trained it, in order; empty: unknown


class Quartiles(NamedTuple):
    """Quartiles of one indicator over runs."""

    low: float
    median: float
    high: float


def names(runs: Sequence[AnyPath]) -> list[str]:
    """Return a short name for each run: the shortest end of its path that is unique.

    A checkpoint is named after its run and its file, such as `20261120-054533-0-latest`. Raises
    MorlaxError if a run is given twice.
    """
    paths = []
    for run in runs:
        folder, file = find_run(run).resolve(), Path(run)
        paths.append(folder.with_name(f"{folder.name}-{file.stem}") if file.is_file() else folder)
        if paths.index(paths[-1]) < len(paths) - 1:
            raise MorlaxError(f"{run} is given twice: name each run once.")
    parts = [path.parts[1:] for path in paths]  # an absolute name would leave the output folder
    for depth in range(1, 2 + max(map(len, parts))):
        found = ["/".join(some[-depth:]) for some in parts]
        if len(set(found)) == len(found):
            break
    return found


def check_comparable(policies: Mapping[str, Policy]) -> None:
    """Raise MorlaxError unless the returns of policies, given by name, can be compared."""
    (first, one), *others = policies.items()
    for name, other in others:
        if movable(one.config.env) != movable(other.config.env):
            raise MorlaxError(
                f"{first} is a run of {one.config.env!r} and {name} of {other.config.env!r}: "
                "compare runs of one task only."
            )
        if one.objectives != other.objectives:
            raise MorlaxError(
                f"{first} has the objectives {', '.join(one.objectives)} and {name} has "
                f"{', '.join(other.objectives)}: compare runs with the same objectives only."
            )
        mine, theirs = (p.config.task.for_evaluation().model_dump() for p in (one, other))
        for option in mine:
            if option not in BUFFERS and not _same(option, mine[option], theirs[option]):
                raise MorlaxError(
                    f"{first} and {name} differ in task.{option} ({mine[option]} and "
                    f"{theirs[option]}), so their returns cannot be compared: evaluate them "
                    "separately."
                )


def own_protocol(policies: Mapping[str, Policy]) -> Protocol:
    """Return the protocol that training evaluated by, or raise MorlaxError if policies differ."""
    own: dict[str, Protocol] = {name: p.config.evaluation.protocol for name, p in policies.items()}
    (first, one), *others = own.items()
    for name, other in others:
        if one != other:
            raise MorlaxError(
                f"{first} and {name} differ in evaluation.protocol ({one} and {other}), so their "
                f"returns cannot be compared: use morlax evaluate --protocol {one}."
            )
    return one


def _same(option: str, mine: Any, theirs: Any) -> bool:
    if option == "learned" and mine and theirs:  # every run has a file of its own
        return read(mine, "learned reward") == read(theirs, "learned reward")
    return mine == theirs


def union(fronts: Sequence[Front]) -> np.ndarray:
    return pareto.front(np.concatenate([front.returns for front in fronts]))


def measures(front: Front, reference_front: np.ndarray | None) -> dict[str, float]:
    """Return the indicators, mean episode length in control steps, and ranges of returns, by name.

    Without a reference front (n, m), IGD+ is left out.
    """
    found = front.indicators(reference_front)
    found["episode_length"] = float(front.lengths.mean())
    for name, returns in zip(front.objectives, front.returns.T, strict=True):
        found[f"{name}_min"] = float(returns.min())
        found[f"{name}_max"] = float(returns.max())
    return found


def quartiles(measured: Sequence[Mapping[str, float]]) -> dict[str, Quartiles]:
    """Return the quartiles of every measure over runs, interpolated linearly between runs."""
    return {
        name: Quartiles(*np.quantile([m[name] for m in measured], (0.25, 0.5, 0.75)).tolist())
        for name in measured[0]
    }
