"""Policies that stand for a whole front: its extremes, its knee and the balanced one."""

import numpy as np

from .front import Front


def representatives(front: Front) -> dict[int, str]:
    """Return the indices of a front's representative policies, with their names.

    The best policy of each objective comes first. The knee has the largest sum of returns, each
    scaled to its range over the front: it gives up least of all objectives together. The balanced
    policy is that of the trade-off closest to equal weights, even if it is dominated. A policy that
    is several of them has one name for all.
    """
    best = np.flatnonzero(front.non_dominated)
    returns, found = front.returns[best], dict[int, str]()
    extent = np.ptp(returns, axis=0)
    scaled = (returns - returns.min(0)) / np.where(extent > 0, extent, 1.0)
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)
    chosen = {
        f"best {name}": best[returns[:, k].argmax()] for k, name in enumerate(front.objectives)
    }
    chosen["knee"] = best[scaled.sum(1).argmax()]
    chosen["balanced"] = np.square(shares - 1 / len(front.objectives)).sum(1).argmin()
    for name, index in chosen.items():
        found[int(index)] = f"{found[int(index)]}, {name}" if int(index) in found else name
    return found
