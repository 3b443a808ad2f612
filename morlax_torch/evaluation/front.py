"""A front: the returns of many trade-offs, and its indicators."""

import io
from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from ..configuration.sections import Protocol
from ..envs import MorlaxError
from ..envs.errors import LONGEST
from ..envs.worlds.options import check_objectives
from ..host.files import AnyPath, read, replacing
from . import pareto

TEXTS = ("fingerprint", "checkpoint", "protocol")
SIGNED = ("returns", "reference_point", "quantities")
EXACT, APPROXIMATE = "hypervolume", "hypervolume_approximate"  # names of the indicator


class Front(NamedTuple):
    """The returns of a family of policies, one point per trade-off."""

    objectives: tuple[str, ...]
    tradeoffs: np.ndarray  # (K, m)
    returns: np.ndarray  # (K, m) sums of rewards, as the protocol counts them
    lengths: np.ndarray  # (K,) control steps until the episode ended
    reference_point: np.ndarray  # (m,)
    falls: np.ndarray | None = None  # (K,) share of episodes that failed; None: unknown
    blowups: np.ndarray | None = None  # (K,) share of episodes that blew up; None: unknown
    quantities: np.ndarray | None = None  # (K, q) means over episodes; None: not measured
    quantity_names: tuple[str, ...] = ()  # with units, such as "power (W)"
    fingerprint: str = ""  # of the evaluated policies, see `runs.checkpoint`; "": unknown
    checkpoint: str = ""  # file of the evaluated policies, such as "best.pt"; "": unknown
    protocol: Protocol = "latched"

    @property
    def values(self) -> np.ndarray:
        """(K, m + q) returns, then quantities if they were measured."""
        measured = () if self.quantities is None else (self.quantities,)
        return np.hstack([self.returns, *measured])

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

        Adds `fall_rate` and `blowup_rate` if they are known, and `igd_plus` if there is a
        reference front (n, m). A hypervolume that is not exact is called `hypervolume_approximate`.
        """
        returns = self.returns
        exact = pareto.is_exact(*returns.shape)
        found = {
            EXACT if exact else APPROXIMATE: self.hypervolume,
            "sparsity": pareto.sparsity(returns),
            "expected_utility": pareto.expected_utility(returns, self.tradeoffs),
            "cardinality": pareto.cardinality(returns),
            "obedience": pareto.obedience(returns, self.tradeoffs),
        }
        if self.falls is not None:
            found["fall_rate"] = float(self.falls.mean())
        if self.blowups is not None:
            found["blowup_rate"] = float(self.blowups.mean())
        if reference_front is not None:
            found["igd_plus"] = pareto.igd_plus(returns, reference_front)
        return found

    @property
    def hypervolume(self) -> float:
        return pareto.hypervolume(self.returns, self.reference_point)

    def averaged(self, episodes: int) -> Self:
        """Average everything over episodes, from (episodes * K, ...) to (K, ...).

        The K trade-offs are repeated `episodes` times in a row.
        """

        def mean(values: np.ndarray) -> np.ndarray:
            return values.reshape(episodes, -1, *values.shape[1:]).mean(0)

        return self._replace(
            tradeoffs=self.tradeoffs[: len(self.tradeoffs) // episodes],
            returns=mean(self.returns),
            lengths=mean(self.lengths),
            falls=None if self.falls is None else mean(self.falls),
            blowups=None if self.blowups is None else mean(self.blowups),
        )

    def parts(self, number: int) -> list[Self]:
        """Split into so many fronts, of as many trade-offs each."""
        columns = {
            name: np.split(values, number)
            for name, values in self._asdict().items()
            if isinstance(values, np.ndarray) and name != "reference_point"
        }
        return [
            self._replace(**{name: pieces[index] for name, pieces in columns.items()})
            for index in range(number)
        ]

    def save(self, path: AnyPath) -> None:
        """Write an .npz with one array per field, and `non_dominated`.

        Raises:
            MorlaxError: the file cannot be written.
        """
        known = {name: value for name, value in self._asdict().items() if value is not None}
        with replacing(path) as file:
            np.savez_compressed(file, non_dominated=self.non_dominated, **known)

    @classmethod
    def load(cls, path: AnyPath) -> Self:
        """Read a file that `save` wrote.

        Raises:
            MorlaxError: there is no such file, or it is damaged.
        """
        whole = io.BytesIO(read(path, "front"))
        try:
            with np.load(whole) as arrays:
                needed = [f for f in cls._fields if f in arrays or f not in cls._field_defaults]
                fields = {name: arrays[name] for name in needed}
            texts = {name: str(fields[name]) for name in TEXTS if name in fields}
            named = ("objectives", "quantity_names")
            names = {name: tuple(map(str, fields[name])) for name in named if name in fields}
            front = cls(**{**fields, **texts, **names})
            front._check()
            return front
        except MemoryError:
            raise
        except Exception as error:  # numpy, zip and zlib each fail in their own way
            reason = " ".join(str(error).split())[:LONGEST].rstrip(".")
            raise MorlaxError(f"{path} is damaged or not a front: {reason}.") from None

    def _check(self) -> None:
        """Raise ValueError if sizes disagree, or a number is not finite or out of range."""
        check_objectives(self.objectives)
        K, m = len(self.tradeoffs), len(self.objectives)
        shapes = {"tradeoffs": (K, m), "returns": (K, m), "reference_point": (m,)}
        shapes["quantities"] = K, len(self.quantity_names)
        for name, values in self._asdict().items():
            if name in TEXTS:
                if len(values) > LONGEST or not values.isprintable():
                    raise ValueError(f"{name} must be a short text")
                continue
            if name in ("objectives", "quantity_names") or values is None:
                continue
            shape = shapes.get(name, (K,))
            if values.shape != shape or values.dtype.kind not in "fiu":
                raise ValueError(f"{name} must hold numbers of shape {shape}")
            if not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite")
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
    chosen = {
        f"best {name}": best[returns[:, k].argmax()] for k, name in enumerate(front.objectives)
    }
    chosen["knee"] = best[scaled.sum(1).argmax()]
    chosen["balanced"] = np.square(shares - 1 / len(front.objectives)).sum(1).argmin()
    names: dict[int, list[str]] = {}
    for name, index in chosen.items():
        names.setdefault(int(index), []).append(name)
    return {index: ", ".join(parts) for index, parts in names.items()}


def mean_indicators(fronts: Sequence[Front]) -> dict[str, float]:
    """Return the mean of each indicator over fronts, such as those of several bodies."""
    found = [front.indicators() for front in fronts]
    # numbers of policies stay whole
    return {name: type(one)(np.mean([x[name] for x in found])) for name, one in found[0].items()}


def hypervolume_in(names: Iterable[str]) -> str:
    """Return the hypervolume's name among names of indicators, or raise StopIteration."""
    return next(name for name in names if name in (EXACT, APPROXIMATE))
