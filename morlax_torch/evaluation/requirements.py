"""Required values, the value to maximize, and the choice that follows from both."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ..envs import MorlaxError
from .names import Names


class Choice(NamedTuple):
    """A trade-off whose policy keeps its requirements."""

    tradeoff: tuple[float, ...]  # the simulated one; at most 5 decimals, which sum to one
    returns: dict[str, float]  # by objective: simulated; of a `Front`: evaluated
    promised: dict[str, float]  # before the simulation: evaluated, or interpolated
    margins: dict[str, float]  # by required name: distance kept from the nearest requirement
    cost: float  # of the requirements: best maximized value without them minus this one
    simulated: int  # number of simulated trade-offs; 0: chosen from a `Front` alone
    quantities: dict[str, float]  # by full name, such as "power (W)": measured as the returns
    falls: float = 0.0  # share of episodes that failed, which breaks every requirement

    @property
    def values(self) -> np.ndarray:
        """(m + q,) returns, then quantities."""
        return np.array([*self.returns.values(), *self.quantities.values()])

    @property
    def names(self) -> Names:
        return Names(tuple(self.returns), tuple(self.quantities))


class Limit(NamedTuple):
    """The least or the largest value that a policy may have."""

    index: int  # of the value
    sign: int  # 1: at least, -1: at most
    level: float

    def shown(self, spec: str = "g") -> str:
        """Return the limit as text, its level in a format of numbers."""
        return f"{'' if self.sign > 0 else 'at most '}{self.level:{spec}}"


class Requirements(NamedTuple):
    """Limits to the values (m + q,) of policies, and the value to maximize.

    Values are returns by objective, then measured quantities. A quantity that is not finite keeps
    no requirement; one that is neither required nor maximized is ignored.
    """

    names: Names
    limits: tuple[Limit, ...]
    maximized: int  # index of a value
    span: np.ndarray  # (m + q,) range of each value, above zero
    margin: float = 0.0  # share of a value's range by which a limit must be exceeded

    @classmethod
    def of(
        cls,
        names: Names,
        at_least: Mapping[str, float],
        at_most: Mapping[str, float],
        maximize: str,
    ) -> Self:
        """Check and convert requirements, without a margin; `choose` describes them.

        Raises:
            MorlaxError: a name is unknown or ambiguous, or a number is not finite.
        """
        limits = []
        for sign, levels in ((1, at_least), (-1, at_most)):
            for name, level in levels.items():
                limits.append(Limit(names.index(name), sign, float(level)))
                if not np.isfinite(level):
                    raise MorlaxError(f"the required value of {name} is {level}: use a number.")
        return cls(names, tuple(limits), names.index(maximize), np.ones(len(names.all)))

    def with_margin(self, margin: float, values: np.ndarray) -> Self:
        """Require a margin, as a share of the ranges of values (n, m + q), finite ones.

        Raises:
            MorlaxError: the margin is out of range.
        """
        if not 0 <= margin <= 1:
            raise MorlaxError(f"margin is {margin:g}: it must be from 0 to 1.")
        span = np.ptp(self.relevant(values), axis=0).clip(min=1e-12)
        return self._replace(margin=margin, span=span)

    @property
    def used(self) -> list[int]:
        """Indices of objectives and of required and maximized quantities, in order."""
        limited = (limit.index for limit in self.limits)
        return sorted({*range(len(self.names.objectives)), *limited, self.maximized})

    @property
    def limited(self) -> np.ndarray:
        """(limits,) index of the value that each limit is of."""
        return np.array([limit.index for limit in self.limits], dtype=int)

    def relevant(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, m + q) with zeros in place of ignored ones."""
        found = np.zeros(values.shape)
        found[:, self.used] = values[:, self.used]
        return found

    def finite(self, values: np.ndarray) -> np.ndarray:
        """Return (n,) whether all but the ignored of values (n, m + q) are finite."""
        return np.all(np.isfinite(self.relevant(values)), axis=1)

    @property
    def bounds(self) -> np.ndarray:
        """(limits,) levels with the margin."""
        levels = [limit.level for limit in self.limits]
        return levels + self._signs * self.margin * self.span[self.limited]

    @property
    def _signs(self) -> np.ndarray:
        return np.array([limit.sign for limit in self.limits], dtype=int)

    def excess(self, values: np.ndarray) -> np.ndarray:
        """Return by how much values (..., m + q) keep each bound, (..., limits).

        It is negative where they miss it.
        """
        return self._signs * (values[..., self.limited] - self.bounds)

    def kept(self, values: np.ndarray) -> np.ndarray:
        """Return (n,) whether values (n, m + q) keep every requirement, margins included."""
        return self.finite(values) & (self.excess(values) >= 0).all(1)

    def best(self, values: np.ndarray) -> int | None:
        """Return which of values (n, m + q) keeps every requirement and has most to maximize."""
        kept = self.kept(values)
        maximized = np.where(kept, values[:, self.maximized], -np.inf)
        return int(maximized.argmax()) if kept.any() else None

    def choice(
        self,
        tradeoff: np.ndarray,
        values: np.ndarray,
        promised: np.ndarray,
        unconstrained: float,
        simulated: int,
    ) -> Choice:
        """Return the choice of a trade-off with values and promised values, (m + q,) each.

        `unconstrained`: best maximized value without requirements.
        """
        m = len(self.names.objectives)
        margins: dict[str, float] = {}
        for limit in self.limits:
            name = self.names.all[limit.index]
            distance = limit.sign * (float(values[limit.index]) - limit.level)
            margins[name] = min(distance, margins.get(name, distance))
        return Choice(
            tuple(tradeoff.tolist()),
            dict(zip(self.names.objectives, values[:m].tolist(), strict=True)),
            dict(zip(self.names.objectives, promised[:m].tolist(), strict=True)),
            margins,
            max(0.0, unconstrained - float(values[self.maximized])),
            simulated,
            dict(zip(self.names.quantities, values[m:].tolist(), strict=True)),
        )

    def missed(self, tradeoffs: np.ndarray, values: np.ndarray, source: str) -> MorlaxError:
        """Say by how much the nearest of trade-offs (n, m) and values (n, m + q) misses.

        The values are "simulated" or "evaluated".
        """
        finite = self.finite(values)
        if not finite.any():
            needed = " and ".join(self.names.all[index] for index in self.used)
            return MorlaxError(
                f"no {source} policy has finite numbers for {needed}: choose another checkpoint, "
                "or require and maximize other quantities."
            )
        excess = self.excess(values[finite])
        nearest = int((excess / self.span[self.limited]).min(1).argmax())
        parts = []
        for limit, bound, kept in zip(self.limits, self.bounds, excess[nearest], strict=True):
            if kept >= 0:
                continue
            name, value = self.names.all[limit.index], values[finite][nearest, limit.index]
            margin = f" {bound:.5g} with its margin," if bound != limit.level else ""
            more = "less" if limit.sign > 0 else "more"
            parts.append(
                f"{name} {value:.5g} instead of {limit.shown()},{margin} {-kept:.3g} {more}"
            )
        return MorlaxError(
            f"no {source} policy keeps every requirement: the nearest, with the trade-off "
            f"{shown(tradeoffs[finite][nearest])}, has {' and '.join(parts)}."
        )


def shown(tradeoff: Sequence[float] | np.ndarray) -> str:
    """Return a trade-off as text that `parse_tradeoff` reads: "0.73125,0.26875"."""
    return ",".join(f"{weight:.6g}" for weight in tradeoff)
