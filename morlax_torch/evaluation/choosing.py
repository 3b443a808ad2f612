"""Choose a trade-off by what its policy must reach."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..envs import MorlaxError
from ..envs.errors import unknown
from .front import Front

NEIGHBORS = 8  # of each trade-off, towards which returns are interpolated
FRACTIONS = np.linspace(0, 1, 20, endpoint=False)


class Choice(NamedTuple):
    """A trade-off and what to expect of its policy."""

    tradeoff: tuple[float, ...]
    returns: dict[str, float]  # by objective, interpolated between evaluated trade-offs


def choose(front: Front, constraints: Mapping[str, float], maximize: str) -> Choice:
    """Return the trade-off that maximizes one objective while others reach required returns.

    Searches evaluated trade-offs and, with interpolated returns, the lines between neighbors.

    Args:
        front: evaluated trade-offs.
        constraints: least return by objective.
        maximize: an objective.

    Raises:
        MorlaxError: there is no such objective, or no policy reaches the required returns.
    """
    names = front.objectives
    for name in (*constraints, maximize):
        if name not in names:
            raise unknown("objective", name, names)
    tradeoffs, returns = _candidates(front)
    required = np.full(len(names), -np.inf)
    for name, least in constraints.items():
        required[names.index(name)] = least
    short = np.maximum(required - returns, 0.0)
    allowed = ~short.any(1)
    if not allowed.any():
        raise _infeasible(front, constraints, returns, short)
    value = np.where(allowed, returns[:, names.index(maximize)], -np.inf)
    best = int(value.argmax())
    expected = dict(zip(names, returns[best].tolist(), strict=True))
    return Choice(tuple(tradeoffs[best].tolist()), expected)


def _candidates(front: Front) -> tuple[np.ndarray, np.ndarray]:
    """Return trade-offs and returns, (n, m) each, evaluated or between two evaluated ones."""
    finite = np.isfinite(front.returns).all(1)
    if not finite.any():
        raise MorlaxError("the front has no finite returns: evaluate the run again.")
    tradeoffs, returns = front.tradeoffs[finite], front.returns[finite]
    squares = (tradeoffs**2).sum(1)
    distances = squares[:, None] + squares - 2 * tradeoffs @ tradeoffs.T
    neighbors = 2 if tradeoffs.shape[1] == 2 else NEIGHBORS
    near = distances.argsort(1, kind="stable")[:, : 1 + neighbors]  # with itself

    def between(values: np.ndarray) -> np.ndarray:
        steps = values[near] - values[:, None]
        moved = values[:, None, None] + FRACTIONS[:, None] * steps[:, :, None]
        return moved.reshape(-1, values.shape[1])

    return between(tradeoffs), between(returns)


def _infeasible(
    front: Front, constraints: Mapping[str, float], returns: np.ndarray, short: np.ndarray
) -> MorlaxError:
    """Say by how much the required returns are missed."""
    names = front.objectives
    for name, least in constraints.items():
        most = returns[:, names.index(name)].max()
        if most < least:
            return MorlaxError(
                f"no policy reaches {name} >= {least:g}: the most is {most:.4g}, "
                f"{least - most:.4g} less."
            )
    width = np.ptp(returns, axis=0).clip(min=1e-12)
    nearest = int((short / width).max(1).argmin())
    missed = ", ".join(
        f"{name} {returns[nearest, names.index(name)]:.4g} instead of {least:g}"
        for name, least in constraints.items()
        if short[nearest, names.index(name)] > 0
    )
    return MorlaxError(f"no policy reaches all of that at once: the nearest has {missed}.")
