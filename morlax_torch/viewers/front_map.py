"""A front as the page draws it: a map of policies."""

from typing import Any

import numpy as np

from ..evaluation import pareto
from ..evaluation.front import Front

FAILS = 0.5  # share of episodes with a fall, from which on a policy is marked


def front_map(front: Front, dt: float) -> dict[str, Any]:
    """Describe a front for the page.

    Its axes are the objectives' returns per second, then measured quantities such as "power (W)";
    `pair` are the axes to show first.

    Args:
        front: evaluated trade-offs.
        dt: seconds of a control step.
    """
    seconds = dt * front.lengths.clip(1)[:, None]
    values, names = front.returns / seconds, [f"{name} per second" for name in front.objectives]
    if front.quantities is not None:
        values, names = np.hstack([values, front.quantities]), [*names, *front.quantity_names]
    falls = np.zeros(len(front.returns)) if front.falls is None else front.falls
    known = [bool(np.isfinite(column).all()) for column in values.T]
    return {
        "tradeoffs": front.tradeoffs.round(4).tolist(),
        "axes": [name for name, finite in zip(names, known, strict=True) if finite],
        "values": values[:, known].round(4).tolist(),
        "returns": front.returns.round(2).tolist(),
        "best": front.non_dominated.tolist(),
        "fails": (falls > FAILS).tolist(),
        "pair": pareto.most_conflicting_pair(front.returns[front.non_dominated]),
        "checkpoint": front.checkpoint,
    }
