"""Trade-offs as users edit them: m numbers, not negative, that sum to one."""

import math
import re
from collections.abc import Iterable, Sequence

Weights = tuple[float, ...]


def even(m: int) -> Weights:
    """Return the balanced trade-off of m objectives."""
    return (1 / m,) * m


def move_slider(weights: Sequence[float], index: int, value: float) -> Weights:
    """Set the weight of one objective and rescale the others, so that all sum to one.

    The others keep their proportions; if all of them are zero, they share the remainder evenly.

    Args:
        weights: the current trade-off (m,).
        index: of the objective.
        value: its new weight, clipped to [0, 1]; a value that is not finite changes nothing.
    """
    if not math.isfinite(value):
        return tuple(weights)
    value = min(max(value, 0.0), 1.0)
    others = [w for i, w in enumerate(weights) if i != index]
    rest = sum(others)
    shares = [(1 - value) * (w / rest if rest else 1 / len(others)) for w in others]
    return (*shares[:index], value, *shares[index:])


def normalized(weights: Sequence[float]) -> Weights | None:
    """Scale a trade-off to sum to one; None if it is invalid (negative, all zero, not finite)."""
    total = sum(weights)
    if not all(w >= 0 for w in weights) or not 0 < total < math.inf:
        return None
    return tuple(w / total for w in weights)


def read(text: str, m: int) -> Weights | None:
    """Parse a typed trade-off of m numbers, such as "0.7, 0.3"; None if it is invalid."""
    try:
        numbers = [float(word) for word in re.split(r"[,;\s]+", text.strip("()[] \t"))]
    except ValueError:
        return None
    return normalized(numbers) if len(numbers) == m else None


def show(weights: Iterable[float]) -> str:
    """Format a trade-off for `read`, with three decimals."""
    return ", ".join(f"{w:.3f}" for w in weights)
