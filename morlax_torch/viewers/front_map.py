"""A front as the page draws it: a map of policies."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..evaluation import pareto
from ..evaluation.evaluator import DISCOUNT
from ..evaluation.front import Front

FAILS = 0.5  # share of episodes with a fall, from which on a policy is marked


def front_map(front: Front, dt: float, lower_is_better: Sequence[str] = ()) -> dict[str, Any]:
    """Describe a front for the page.

    Its axes are the objectives' rewards per second, weighted as in the returns, then measured
    quantities such as "power (W)"; `pair` are the axes to show first. `measured` are the quantities
    that can be required.

    Args:
        front: evaluated trade-offs.
        dt: seconds of a control step.
        lower_is_better: names of quantities.
    """
    steps = front.lengths.clip(1)[:, None]
    if front.protocol == "discounted":
        steps = (1 - DISCOUNT**steps) / (1 - DISCOUNT)  # sum of the steps' weights
    values = front.returns / (dt * steps)
    names = [f"{name} per second" for name in front.objectives]
    if front.quantities is not None:
        values, names = np.hstack([values, front.quantities]), [*names, *front.quantity_names]
    falls = np.zeros(len(front.returns)) if front.falls is None else front.falls
    known = [bool(np.isfinite(column).all()) for column in values.T]
    return {
        "tradeoffs": front.tradeoffs.round(4).tolist(),
        "axes": [name for name, finite in zip(names, known, strict=True) if finite],
        "values": values[:, known].round(4).tolist(),
        "returns": front.returns.round(2).tolist(),
        "measured": _measured(front, lower_is_better),
        "best": front.non_dominated.tolist(),
        "fails": (falls > FAILS).tolist(),
        "falls": falls.round(4).tolist(),
        "pair": pareto.most_conflicting_pair(front.returns[front.non_dominated]),
        "checkpoint": front.checkpoint,
    }


def _measured(front: Front, lower_is_better: Sequence[str]) -> list[dict[str, Any]]:
    """Describe quantities that are finite; indices count the objectives first."""
    if front.quantities is None:
        return []
    columns = zip(front.quantity_names, front.quantities.T, strict=True)
    return [
        {
            "index": index,
            "name": name,
            "lower": name in lower_is_better,
            "values": values.round(4).tolist(),
        }
        for index, (name, values) in enumerate(columns, len(front.objectives))
        if np.isfinite(values).all()
    ]
