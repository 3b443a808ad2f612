"""A front: the returns of many trade-offs, and its indicators."""

import io
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ..configuration.sections import Protocol
from ..envs.errors import LONGEST, MorlaxError, line
from ..envs.worlds.options import check_objectives
from ..host.files import AnyPath, read, replacing
from . import pareto

TEXTS = {"fingerprint", "checkpoint", "protocol"}
NAMES = {"objectives", "quantity_names", "titles"}
SIGNED = {"returns", "reference_point", "quantities"}
FAILS = 0.5  # share of episodes with a fall, from which on a policy is marked
EXACT, APPROXIMATE = "hypervolume", "hypervolume_approximate"  # names of the indicator


class Front(NamedTuple):
    """The returns of a family of policies, one point per trade-off."""

    objectives: tuple[str, ...]
    tradeoffs: np.ndarray  # (K, m)
    returns: np.ndarray  # (K, m) sums of rewards, as the protocol counts them
    lengths: np.ndarray  # (K,) control steps until the episode ended
    reference_point: np.ndarray  # (m,)
    falls: np.ndarray  # (K,) share of episodes that failed
    blowups: np.ndarray | None = None  # (K,) share of episodes that blew up; None: unknown
    quantities: np.ndarray | None = None  # (K, q) means over episodes; None: not measured
    quantity_names: tuple[str, ...] = ()  # with units, such as "power (W)"
    fingerprint: str = ""  # of the evaluated policies, see `runs.checkpoint`; "": unknown
    checkpoint: str = ""  # file of the evaluated policies, such as "best.pt"; "": unknown
    protocol: Protocol = "latched"
    titles: tuple[str, ...] = ()  # of objectives, for people; (): their names

    @property
    def values(self) -> np.ndarray:
        """(K, m + q) returns, then quantities if they were measured."""
        measured = () if self.quantities is None else (self.quantities,)
        return np.hstack([self.returns, *measured])

    @property
    def shown(self) -> tuple[str, ...]:
        """What people read as the objectives' names: "energy saved"."""
        return self.titles or self.objectives

    @property
    def fails(self) -> np.ndarray:
        """(K,) bool: falls in most episodes"""
        return self.falls > FAILS

    @property
    def non_dominated(self) -> np.ndarray:
        """(K,) bool"""
        return pareto.non_dominated(self.returns)

    @property
    def obeys(self) -> np.ndarray:
        """(K,) bool"""
        return pareto.obeys(self.returns, self.tradeoffs)

    def indicators(self, reference_front: ArrayLike | None = None) -> dict[str, float]:
        """Compute hypervolume, sparsity, expected utility, cardinality and obedience, by name.

        Adds `fall_rate`, `blowup_rate` if it is known, and `igd_plus` if there is a reference
        front (n, m). A hypervolume that is not exact is called `hypervolume_approximate`.
        """
        returns = self.returns
        exact = pareto.is_exact(*returns.shape)
        indicators = {
            EXACT if exact else APPROXIMATE: self.hypervolume,
            "sparsity": pareto.sparsity(returns),
            "expected_utility": pareto.expected_utility(returns, self.tradeoffs),
            "cardinality": pareto.cardinality(returns),
            "obedience": pareto.obedience(returns, self.tradeoffs),
            "fall_rate": float(self.falls.mean()),
        }
        if self.blowups is not None:
            indicators["blowup_rate"] = float(self.blowups.mean())
        if reference_front is not None:
            indicators["igd_plus"] = pareto.igd_plus(returns, reference_front)
        return indicators

    @property
    def hypervolume(self) -> float:
        return pareto.hypervolume(self.returns, self.reference_point)

    def _arrays(self) -> dict[str, np.ndarray]:
        fields = self._asdict().items()
        return {name: values for name, values in fields if isinstance(values, np.ndarray)}

    def parts(self, number: int) -> list[Self]:
        """Split into so many fronts, of as many trade-offs each."""
        rows = self._arrays()
        del rows["reference_point"]
        columns = {name: np.split(values, number) for name, values in rows.items()}
        return [
            self._replace(**{name: pieces[index] for name, pieces in columns.items()})
            for index in range(number)
        ]

    def save(self, path: AnyPath) -> None:
        """Write an .npz with one array per field, and `non_dominated`.

        Raises:
            MorlaxError: the file cannot be written.
        """
        fields = {name: value for name, value in self._asdict().items() if value is not None}
        with replacing(path) as file:
            np.savez_compressed(file, non_dominated=self.non_dominated, **fields)

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a file that `save` wrote.

        Raises:
            MorlaxError: there is no such file, or it is damaged.
        """
        content = io.BytesIO(read(path, "front"))
        try:
            with np.load(content) as arrays:
                fields: dict[str, Any] = {f: arrays[f] for f in cls._fields if f in arrays}
            for name in fields.keys() & TEXTS:
                fields[name] = str(fields[name])
            for name in fields.keys() & NAMES:
                fields[name] = tuple(map(str, fields[name]))
            front = cls(**fields)  # which refuses too few fields
            front._check()
            return front
        except MemoryError:
            raise
        except Exception as error:  # numpy, zip and zlib each fail in their own way
            reason = line(error)[:LONGEST].rstrip(".")
            raise MorlaxError(f"{path} is damaged or not a front: {reason}.") from None

    def _check(self) -> None:
        """Raise ValueError if sizes disagree, or a number is not finite or out of range.

        Quantities need not be finite: a robot that stands may have no cost of transport.
        """
        check_objectives(self.objectives)
        K, m = len(self.tradeoffs), len(self.objectives)
        shapes = {"tradeoffs": (K, m), "returns": (K, m), "reference_point": (m,)}
        shapes["quantities"] = K, len(self.quantity_names)
        for name, values in self._arrays().items():
            shape = shapes.get(name, (K,))
            numbers = values.shape == shape and values.dtype.kind in "fiu"
            if not numbers or not (name == "quantities" or np.isfinite(values).all()):
                raise ValueError(f"{name} must hold finite numbers of shape {shape}")
            if name not in SIGNED and (values < 0).any():
                raise ValueError(f"{name} must not be negative")
        if K == 0 or not (self.tradeoffs.sum(1) > 0).all():
            raise ValueError("there must be trade-offs, each with a weight above zero")


def representatives(front: Front) -> dict[int, str]:
    """Return the indices of policies that stand for a front, with their names.

    They are the best policies of each objective; the knee, whose returns, scaled to their ranges
    over the front, have the largest sum; and the balanced policy, whose trade-off is closest to
    equal weights, even if it is dominated. A policy that is several of them has all their names.
    """
    best = np.flatnonzero(front.non_dominated)
    returns = front.returns[best]
    extent = np.ptp(returns, axis=0)
    scaled = (returns - returns.min(0)) / np.where(extent > 0, extent, 1.0)
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)
    chosen = {f"best {name}": best[returns[:, k].argmax()] for k, name in enumerate(front.shown)}
    chosen["knee"] = best[scaled.sum(1).argmax()]
    chosen["balanced"] = np.square(shares - 1 / len(front.objectives)).sum(1).argmin()
    names: dict[int, list[str]] = {}
    for name, index in chosen.items():
        names.setdefault(int(index), []).append(name)
    return {index: ", ".join(parts) for index, parts in names.items()}


def mean_indicators(fronts: Sequence[Front]) -> dict[str, float]:
    """Return the mean of each indicator over fronts, such as those of several bodies."""
    measured = [front.indicators() for front in fronts]
    means = {name: float(np.mean([each[name] for each in measured])) for name in measured[0]}
    return {**means, "cardinality": round(means["cardinality"])}  # a number of policies


def hypervolume_in(names: Iterable[str]) -> str:
    """Return the hypervolume's name among names of indicators, or raise StopIteration."""
    return next(name for name in names if name in (EXACT, APPROXIMATE))
