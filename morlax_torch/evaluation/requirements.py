"""Required values, the value to maximize, and the choice that follows from both."""

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import NamedTuple, Self

import numpy as np

from ..envs.errors import MorlaxError, unknown


class Limit(NamedTuple):
    """The least or the largest value that a policy may have."""

    index: int  # of the value
    sign: int  # 1: at least, -1: at most
    level: float
    bound: float  # level with a margin

    def shown(self, spec: str = "g") -> str:
        """Return the limit as text, its level in a format of numbers."""
        return f"{'' if self.sign > 0 else 'at most '}{self.level:{spec}}"


class Requirements(NamedTuple):
    """Limits to the values (m + q,) of policies, and the value to maximize.

    Values are returns by objective, then measured quantities. A quantity that is not finite keeps
    no requirement; one that is neither required nor maximized is ignored.
    """

    objectives: tuple[str, ...]  # m
    quantities: tuple[str, ...]  # q, with units, such as "power (W)"
    limits: tuple[Limit, ...]
    maximized: int  # index of a value

    @classmethod
    def of(
        cls,
        objectives: Sequence[str],
        quantities: Sequence[str],
        at_least: Mapping[str, float],
        maximize: str,
        at_most: Mapping[str, float],
    ) -> Self:
        """Check and convert requirements by name, without a margin."""
        limits = []
        for sign, levels in ((1, at_least), (-1, at_most)):
            for name, level in levels.items():
                if not isinstance(level, Real) or not np.isfinite(level):
                    raise MorlaxError(f"the required value of {name} is {level}: use a number.")
                index = index_of(name, objectives, quantities)
                limits.append(Limit(index, sign, float(level), float(level)))
        maximized = index_of(maximize, objectives, quantities)
        return cls(tuple(objectives), tuple(quantities), tuple(limits), maximized)

    def with_margin(self, margin: float, span: np.ndarray) -> Self:
        """Require a margin, as a share of the ranges (m + q,) of values, or raise MorlaxError."""
        if not 0 <= margin <= 1:
            raise MorlaxError(f"margin is {margin:g}: it must be from 0 to 1.")
        limits = [
            limit._replace(bound=limit.level + limit.sign * margin * float(span[limit.index]))
            for limit in self.limits
        ]
        return self._replace(limits=tuple(limits))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values (m + q,)."""
        return (*self.objectives, *self.quantities)

    @property
    def limited(self) -> list[int]:
        """Index of the value that each limit is of."""
        return [limit.index for limit in self.limits]

    @property
    def used(self) -> list[int]:
        """Indices of objectives and of required and maximized quantities, in order."""
        return sorted({*range(len(self.objectives)), *self.limited, self.maximized})

    def relevant(self, values: np.ndarray) -> np.ndarray:
        """Return values (n, m + q) with zeros in place of ignored ones."""
        return np.where(np.isin(np.arange(values.shape[1]), self.used), values, 0.0)

    def finite(self, values: np.ndarray) -> np.ndarray:
        """Return (n,) whether all but the ignored of values (n, m + q) are finite."""
        return np.all(np.isfinite(values[:, self.used]), axis=1)

    def span(self, values: np.ndarray) -> np.ndarray:
        """Return the range (m + q,) of each of values (n, m + q), above zero."""
        finite = values[self.finite(values)]
        if len(finite) == 0:
            needed = " and ".join(self.names[index] for index in self.used)
            raise MorlaxError(
                f"no policy has finite numbers for {needed}: choose another checkpoint, or "
                "require and maximize other quantities."
            )
        return np.ptp(self.relevant(finite), axis=0).clip(min=1e-12)

    def excess(self, values: np.ndarray) -> np.ndarray:
        """Return by how much values (..., m + q) keep each bound, (..., limits)."""
        signs = np.array([limit.sign for limit in self.limits])
        return signs * (values[..., self.limited] - [limit.bound for limit in self.limits])

    def margins(self, values: np.ndarray) -> dict[str, float]:
        """Return by how much values (m + q,) keep the nearest bound, by the value's name."""
        excess = self.excess(values)
        return {
            self.names[index]: float(excess[np.equal(self.limited, index)].min())
            for index in dict.fromkeys(self.limited)
        }

    def kept(self, values: np.ndarray) -> np.ndarray:
        """Return (n,) whether values (n, m + q) keep every requirement, margins included."""
        return self.finite(values) & (self.excess(values) >= 0).all(1)

    def ranked(self, tradeoffs: np.ndarray, values: np.ndarray, source: str) -> np.ndarray:
        """Return which trade-offs (n, m) with values (n, m + q) keep all limits, best first."""
        rows = self.kept(values).nonzero()[0]
        if len(rows):
            return rows[(-values[rows, self.maximized]).argsort(kind="stable")]
        span, finite = self.span(values), self.finite(values)
        tradeoffs, values = tradeoffs[finite], values[finite]
        excess = self.excess(values)
        nearest = int((excess / span[self.limited]).min(1).argmax())
        raise MorlaxError(
            f"no {source} policy keeps every requirement: the nearest, with the trade-off "
            f"{shown(tradeoffs[nearest])}, has {self.misses(values[nearest])}."
        )

    def misses(self, values: np.ndarray) -> str:
        """Say which bounds values (m + q,) do not keep, and by how much."""
        return " and ".join(
            f"{self.names[limit.index]} {values[limit.index]:.5g} instead of {limit.shown()}, "
            + (f"{limit.bound:.5g} with its margin, " if limit.bound != limit.level else "")
            + f"{-distance:.3g} {'less' if limit.sign > 0 else 'more'}"
            for limit, distance in zip(self.limits, self.excess(values), strict=True)
            if distance < 0
        )


class Choice(NamedTuple):
    """A trade-off whose policy keeps its requirements."""

    tradeoff: tuple[float, ...]  # the simulated one; at most 5 decimals, which sum to one
    returns: dict[str, float]  # by objective: simulated; of a `Front`: evaluated
    promised: dict[str, float]  # before the simulation: evaluated, or interpolated
    margins: dict[str, float]  # by required name: distance kept from the nearest requirement
    cost: float  # of the requirements: best maximized value without them minus this one
    simulated: int  # number of simulated trade-offs; 0: chosen from a `Front` alone
    quantities: dict[str, float]  # by full name, such as "power (W)": measured as the returns
    falls: float  # share of episodes that failed, whose returns and quantities count
    required: Requirements  # without a margin

    @property
    def values(self) -> np.ndarray:
        """(m + q,) returns, then quantities."""
        return np.array([*self.returns.values(), *self.quantities.values()])

    def remarks(self) -> list[str]:
        """Say what the requirements cost, and how often the policy falls, if at all."""
        required, sentences = self.required, []
        if required.limits:
            best = self.values[required.maximized] + self.cost
            sentences.append(
                f"cost of the requirements: {self.cost:.4g} of "
                f"{required.names[required.maximized]}, which reaches {best:.5g} without them"
            )
        if self.falls:
            broken = "; in these it keeps no requirement" if required.limits else ""
            share = f"{self.falls:.0%} of its episodes"
            sentences.append(f"falls: in {share}, which the values above include{broken}")
        return sentences

    def rows(self, spec: str) -> list[list[str]]:
        """Return name, promised and simulated value, requirement and margin of each value used."""
        rows = []
        for index in self.required.used:
            name, limits = self.required.names[index], self.required.limits
            levels = [limit.shown(spec) for limit in limits if limit.index == index]
            promised = f"{self.promised[name]:{spec}}" if name in self.promised else ""
            margin = f"{self.margins[name]:+.4g}" if levels else ""
            value = f"{self.values[index]:{spec}}"
            rows.append([name, promised, value, " and ".join(levels), margin])
        return rows


def index_of(name: str, objectives: Sequence[str], quantities: Sequence[str]) -> int:
    """Return the index of a value (m + q,); a quantity may be named without its unit."""
    names = [*objectives, *quantities]
    matches = [name] if name in names else [q for q in quantities if q.partition(" (")[0] == name]
    if len(matches) > 1:
        raise MorlaxError(f"{name!r} is ambiguous: write {' or '.join(map(repr, matches))}.")
    if matches:
        return names.index(matches[0])
    if quantities:
        raise unknown("objective or quantity", name, names)
    raise MorlaxError(f"{unknown('objective', name, names)} No quantities are measured.")


def shown(tradeoff: Sequence[float] | np.ndarray) -> str:
    """Return a trade-off as text that `parse_tradeoff` reads: "0.73125,0.26875"."""
    return ",".join(f"{weight:.6g}" for weight in tradeoff)
