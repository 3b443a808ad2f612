"""Pareto indicators, computed by moocore. Every objective is maximized; points are (n, m).

They may be tensors on any device, also with gradients.
"""

from itertools import combinations

import moocore
import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..envs.errors import MorlaxError

# Most points of an exact hypervolume by number of objectives: up to half a second of one CPU core,
# measured on mutually non-dominated points. With fewer objectives any number is fast.
EXACT_POINTS = {5: 500, 6: 400, 7: 150, 8: 80, 9: 48, 10: 36}
EXACT_OBJECTIVES = 4
EXACT_POINTS_OF_MORE = 10  # objectives than the table has
OBEDIENCE_TOLERANCE = 0.01


def _array(values: ArrayLike) -> NDArray[np.float64]:
    if isinstance(values, Tensor):
        values = values.detach().double().cpu()
    return np.asarray(values, dtype=np.float64)


def _rows(values: ArrayLike, what: str = "points", m: int | None = None) -> NDArray[np.float64]:
    rows = _array(values)
    if rows.ndim != 2 or m not in (None, rows.shape[1]):
        shape = f"(n, {m or 'm'}), one row for each"
        raise MorlaxError(f"{what} are {shape}, but their shape is {rows.shape}.")
    return rows


def non_dominated(points: ArrayLike) -> NDArray[np.bool_]:
    """Return (n,) bool: True where no other point dominates.

    A point dominates if it is at least as good in all objectives and better in one. Of equal
    points only the first counts. A point that is not finite is dominated.
    """
    points = _rows(points)
    mask = np.zeros(len(points), dtype=np.bool_)
    finite = np.flatnonzero(np.isfinite(points).all(1))
    if len(finite):
        mask[finite] = moocore.is_nondominated(points[finite], maximise=True)
    return mask


def front(points: ArrayLike) -> NDArray[np.float64]:
    """Return the non-dominated points."""
    points = _rows(points)
    return points[non_dominated(points)]


def hypervolume(points: ArrayLike, reference_point: ArrayLike) -> float:
    """Compute the volume between the reference point and the front (Zitzler and Thiele, 1999).

    Exact if `is_exact`, else moocore's deterministic approximation. A point that does not exceed
    the reference point in every objective contributes nothing.
    """
    points, reference = _rows(points), _array(reference_point)
    if reference.shape not in ((), points.shape[1:]) or not np.isfinite(reference).all():
        m = points.shape[1]
        raise MorlaxError(f"a reference point of {m} finite numbers is needed, not {reference}.")
    exact, points = is_exact(*points.shape), front(points)
    points = points[(points > reference).all(1)]
    if not len(points):
        return 0.0
    volume = moocore.hypervolume if exact else moocore.hv_approx
    return float(volume(points, ref=reference, maximise=True))


def is_exact(num_points: int, num_objectives: int) -> bool:
    """Return whether `hypervolume` is exact for so many points and objectives."""
    most = EXACT_POINTS.get(num_objectives, EXACT_POINTS_OF_MORE)
    return num_objectives <= EXACT_OBJECTIVES or num_points <= most


def sparsity(points: ArrayLike) -> float:
    """Compute the mean squared gap between neighbors on the front, summed over objectives.

    Less is denser; the sparsity of one point is 0. (Xu et al., PG-MORL, 2020, eq. 4.)
    """
    points = np.sort(front(points), axis=0)
    return float(np.square(np.diff(points, axis=0)).sum() / max(len(points) - 1, 1))


def expected_utility(points: ArrayLike, tradeoffs: ArrayLike) -> float:
    """Compute the mean over trade-offs (k, m) of the best w . r (Zintgraf et al., 2015)."""
    points = front(points)
    if not len(points):
        return float("-inf")
    return float((_rows(tradeoffs, "trade-offs", points.shape[1]) @ points.T).max(1).mean())


def cardinality(points: ArrayLike) -> int:
    """Count the non-dominated points."""
    return int(non_dominated(points).sum())


def igd_plus(points: ArrayLike, reference_front: ArrayLike) -> float:
    """Compute the mean distance of a reference front Z from the front A (Ishibuchi, 2015).

    1/|Z| sum over z in Z of min over a in A of sqrt(sum_k max(z_k - a_k, 0)^2), in the units of the
    returns: 0 where every point of Z is reached or exceeded.
    """
    points = front(points)
    reference = _rows(reference_front, "points of the reference front", points.shape[1])
    if not np.isfinite(reference).all():
        raise MorlaxError("the reference front has numbers that are not finite.")
    return float(moocore.igd_plus(points, ref=reference, maximise=True)) if len(points) else np.inf


def obeys(
    points: ArrayLike, tradeoffs: ArrayLike, tolerance: float = OBEDIENCE_TOLERANCE
) -> NDArray[np.bool_]:
    """Return (n,) bool: True where a trade-off's own policy is about the best of all for it.

    Point r_i is the return of the policy of trade-off w_i; both are (n, m). With u_ij = w_i . r_j,

        i obeys where  max_j u_ij - u_ii <= tolerance * (max_j u_ij - min_j u_ij).

    The left side is the utility that trade-off i loses by using its own policy (the utility loss of
    Zintgraf et al., 2015, within the set), the bracket the range of utility that any choice of
    policy spans. Policies that tie all obey. A point that is not finite does not obey, and the
    others ignore it.
    """
    points = _rows(points)
    tradeoffs = _rows(tradeoffs, "trade-offs", points.shape[1])
    if len(tradeoffs) != len(points):
        raise MorlaxError(f"{len(points)} points need as many trade-offs, not {len(tradeoffs)}.")
    finite = np.isfinite(points).all(1)
    result = np.zeros(len(points), dtype=np.bool_)
    if finite.any():
        utility = tradeoffs[finite] @ points[finite].T
        most, least = utility.max(1), utility.min(1)
        result[finite] = most - utility.diagonal() <= tolerance * (most - least)
    return result


def obedience(points: ArrayLike, tradeoffs: ArrayLike) -> float:
    """Compute the share of trade-offs that obey (see `obeys`).

    A family of equal policies obeys trivially: read it beside the hypervolume.
    """
    return float(obeys(points, tradeoffs).mean())


def conflicts(points: ArrayLike) -> NDArray[np.float64]:
    """Return how much each pair of objectives conflicts over some points (n, m): (m, m).

    It is Spearman's rank correlation, negated: 1 where more of one objective always means less of
    the other, -1 where they rise together, and 0 for an objective that never changes.
    """
    points = _rows(points)
    below = np.sign(points[:, None] - points[None, :]).sum(1)  # (n, m): ranks, with ties
    lengths = np.linalg.norm(below, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    return -(below / scale).T @ (below / scale)


def conflicting_pairs(points: ArrayLike, most: int = 1) -> list[tuple[int, int]]:
    """Return the pairs of objectives that conflict most over some points (n, m), in their order."""
    conflict = conflicts(points)
    pairs = combinations(range(len(conflict)), 2)
    return sorted(sorted(pairs, key=lambda pair: -conflict[pair])[:most])
