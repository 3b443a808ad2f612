"""Required returns, the objective to maximize, and the choice that follows from both."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from ..envs.errors import unknown


class Choice(NamedTuple):
    """A trade-off whose policy keeps its requirements."""

    tradeoff: tuple[float, ...]  # the simulated one; at most 5 decimals, which sum to one
    returns: dict[str, float]  # by objective: simulated; of a `Front`: evaluated
    promised: dict[str, float]  # before the simulation: evaluated, or interpolated
    margins: dict[str, float]  # by required objective: the return minus the requirement
    cost: float  # of the requirements: best maximized return without them minus this one
    simulated: int  # number of simulated trade-offs; 0: chosen from a `Front` alone


class Requirements(NamedTuple):
    objectives: tuple[str, ...]
    constraints: dict[str, float]  # least returns by objective
    least: np.ndarray  # (m,) with the margin; -inf: not required
    maximized: int  # index of an objective
    span: np.ndarray  # (m,) range of each objective, above zero

    @classmethod
    def of(
        cls,
        objectives: Sequence[str],
        constraints: Mapping[str, float],
        maximize: str,
        margin: float,
        returns: np.ndarray,
    ) -> Self:
        """Check and convert requirements; `choose` describes them.

        The returns (K, m) determine the ranges of objectives, of which the margin is a share.

        Raises:
            MorlaxError: there is no such objective, or a number is out of range.
        """
        objectives = tuple(objectives)
        for name in (*constraints, maximize):
            if name not in objectives:
                raise unknown("objective", name, objectives)
        if not 0 <= margin <= 1:
            raise MorlaxError(f"margin is {margin:g}: it must be from 0 to 1.")
        span = np.ptp(returns, axis=0).clip(min=1e-12)
        least = np.full(len(objectives), -np.inf)
        for name, value in constraints.items():
            if not np.isfinite(value):
                raise MorlaxError(f"the required return of {name} is {value}: use a number.")
            index = objectives.index(name)
            least[index] = value + margin * span[index]
        return cls(objectives, dict(constraints), least, objectives.index(maximize), span)

    def kept(self, returns: np.ndarray) -> np.ndarray:
        """Return (n,) whether returns (n, m) keep every requirement, margins included."""
        return np.all(returns >= self.least, axis=1)

    def best(self, returns: np.ndarray) -> int | None:
        """Return which of returns (n, m) keeps every requirement and has most of the objective."""
        kept = self.kept(returns)
        value = np.where(kept, returns[:, self.maximized], -np.inf)
        return int(value.argmax()) if kept.any() else None

    def choice(
        self,
        tradeoff: np.ndarray,
        returns: np.ndarray,
        promised: np.ndarray,
        unconstrained: float,
        simulated: int,
    ) -> Choice:
        """Return the choice of a trade-off with returns and promised returns, (m,) each.

        `unconstrained`: best return of the maximized objective without requirements.
        """
        value = dict(zip(self.objectives, returns.tolist(), strict=True))
        return Choice(
            tuple(tradeoff.tolist()),
            value,
            dict(zip(self.objectives, promised.tolist(), strict=True)),
            {name: value[name] - least for name, least in self.constraints.items()},
            max(0.0, unconstrained - float(returns[self.maximized])),
            simulated,
        )

    def missed(self, tradeoffs: np.ndarray, returns: np.ndarray, source: str) -> MorlaxError:
        """Say by how much the nearest of trade-offs and returns, (n, m) each, misses.

        The returns are "simulated" or "evaluated".
        """
        short = np.maximum(self.least - returns, 0.0)
        nearest = int((short / self.span).max(1).argmin())
        parts = []
        for name, required in self.constraints.items():
            index = self.objectives.index(name)
            least, value = self.least[index], returns[nearest, index]
            if value < least:
                margin = f" with its margin, {least:.5g}," if least > required else ""
                parts.append(
                    f"{name} {value:.5g} instead of {required:g},{margin} {least - value:.3g} less"
                )
        return MorlaxError(
            f"no {source} policy keeps every requirement: the nearest, with the trade-off "
            f"{shown(tradeoffs[nearest])}, has {' and '.join(parts)}."
        )


def shown(tradeoff: Sequence[float] | np.ndarray) -> str:
    """Return a trade-off as text that `parse_tradeoff` reads: "0.73125,0.26875"."""
    return ",".join(f"{weight:.6g}" for weight in tradeoff)
