"""A trade-off as a user's hand changes it: m numbers, not negative, that sum to one."""

import math
import re
from collections.abc import Iterable, Sequence

Weights = tuple[float, ...]


def even(m: int) -> Weights:
    """Every objective matters the same."""
    return (1 / m,) * m


def move_slider(weights: Sequence[float], index: int, value: float) -> Weights:
    """Give one objective the weight `value`, clipped to [0, 1], and rescale the others.

    The others keep their proportions; where all of them are zero they share what is left evenly.
    A value that is not finite changes nothing.
    """
    if not math.isfinite(value):
        return tuple(weights)
    value = min(max(value, 0.0), 1.0)
    others = [w for i, w in enumerate(weights) if i != index]
    rest = sum(others)
    shares = [(1 - value) * (w / rest if rest else 1 / len(others)) for w in others]
    return (*shares[:index], value, *shares[index:])


def normalised(weights: Sequence[float]) -> Weights | None:
    """The same trade-off with sum one; None where it is none (negative, all zero, not finite)."""
    total = sum(weights)
    if not all(w >= 0 for w in weights) or not 0 < total < math.inf:
        return None
    return tuple(w / total for w in weights)


def read(text: str, m: int) -> Weights | None:
    """The trade-off of m numbers that somebody typed, "0.7, 0.3"; None while it is none."""
    try:
        numbers = [float(word) for word in re.split(r"[,;\s]+", text.strip("()[] \t"))]
    except ValueError:
        return None
    return normalised(numbers) if len(numbers) == m else None


def show(weights: Iterable[float]) -> str:
    """What `read` reads, to three decimals."""
    return ", ".join(f"{w:.3f}" for w in weights)
