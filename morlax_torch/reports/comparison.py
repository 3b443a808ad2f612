"""Compare evaluated runs: short names, comparability, quartiles."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..configuration.config import flat
from ..configuration.sections import Protocol
from ..envs import MorlaxError
from ..envs.naming import movable
from ..evaluation.front import Front
from ..host.files import AnyPath
from ..networks.policy import Policy
from ..runs.hardware import Machine
from ..runs.loading import find_run
from ..runs.progress import History

# options in which repeated runs may differ; their task is the same, wherever its file lies
FREE = {"env", "seed", "device", "backend", "target", "evaluation.every"}
BUFFERS = {"nconmax", "njmax"}  # task options that do not change returns


class Evaluated(NamedTuple):
    """A run and its evaluation."""

    path: str  # as given on the command line
    policy: Policy
    front: Front
    history: History | None  # of training; None: unknown
    measures: dict[str, float]
    machines: Sequence[Machine] = ()  # that trained it, in order; empty: unknown


def names(runs: Sequence[AnyPath]) -> list[str]:
    """Return a short name for each run: the shortest end of its path that is unique.

    A checkpoint is named after its run and its file, such as `20261120-054533-0-latest`. Raises
    MorlaxError if a run is given twice.
    """
    paths: list[Path] = []
    for run in runs:
        path, file = find_run(run).resolve(), Path(run)
        if file.is_file():
            path = path.with_name(f"{path.name}-{file.stem}")
        if path in paths:
            raise MorlaxError(f"{run} is given twice: name each run once.")
        paths.append(path)
    depth, parts = 1, [path.parts[1:] for path in paths]  # not absolute: they name subfolders
    while len({part[-depth:] for part in parts}) < len(parts):
        depth += 1
    return ["/".join(part[-depth:]) for part in parts]


def check_comparable(policies: Mapping[str, Policy], protocol: Protocol | None = None) -> Protocol:
    """Return the protocol to compare returns by (None: that of training), or raise MorlaxError."""
    (first, one), *others = policies.items()
    for name, other in others:
        theirs = _options(other, protocol)
        for option, value in _options(one, protocol).items():
            if value != theirs[option]:
                raise MorlaxError(
                    f"{first} and {name} differ in {option} ({value} and {theirs[option]}), so "
                    "their returns cannot be compared: evaluate them separately, or by one "
                    "--protocol if they differ in that."
                )
    return protocol or one.config.evaluation.protocol


def _options(policy: Policy, protocol: Protocol | None) -> dict[str, Any]:
    """Return what must be equal, the most telling first."""
    config = policy.config
    task = config.task.for_evaluation().model_dump(exclude=BUFFERS)
    return {
        "their task": movable(config.env),
        "their objectives": ", ".join(policy.objectives),
        **{f"task.{name}": value for name, value in task.items()},
        "evaluation.protocol": protocol or config.evaluation.protocol,
    }


def repeated(runs: Mapping[str, Evaluated]) -> bool:
    """Return whether runs of one task differ only in their seeds, so that they have a median."""
    first, *others = (flat(run.policy.config.model_dump()) for run in runs.values())
    differing = {name for other in others for name in other if other[name] != first.get(name)}
    seeds = {first["seed"], *(other["seed"] for other in others)}
    return differing <= FREE and 1 < len(seeds) == len(runs)


def measures(front: Front, reference_front: np.ndarray | None) -> dict[str, float]:
    """Return the indicators, mean episode length and ranges of returns, by name."""
    values = front.indicators(reference_front) | {"episode_length": float(front.lengths.mean())}
    for name, returns in zip(front.objectives, front.returns.T.tolist(), strict=True):
        values |= {f"{name}_min": min(returns), f"{name}_max": max(returns)}
    return values


def quartiles(measured: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, ...]]:
    """Return the quartiles of all runs' measures by name, interpolated linearly between runs."""
    return {
        name: tuple(np.quantile([m[name] for m in measured], (0.25, 0.5, 0.75)).tolist())
        for name in measured[0]
        if all(name in values for values in measured)
    }
