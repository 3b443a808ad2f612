"""Pareto indicators, by moocore. Every objective is maximised; points are (n, m)."""

import moocore
import numpy as np
from numpy.typing import ArrayLike, NDArray

# Exact hypervolume takes time exponential in m; from here on moocore's approximation is used.
EXACT_OBJECTIVES = 4
EXACT_POINTS = 500
OBEDIENCE_TOLERANCE = 0.01


def non_dominated(points: ArrayLike) -> NDArray[np.bool_]:
    """(n,) True where no other point is at least as good in all objectives and better in one.

    Of equal points the first counts. A point that is not finite is dominated.
    """
    points = np.asarray(points, dtype=np.float64)
    mask = np.zeros(len(points), dtype=np.bool_)
    finite = np.flatnonzero(np.isfinite(points).all(1))
    if len(finite):
        mask[finite] = moocore.is_nondominated(points[finite], maximise=True)
    return mask


def front(points: ArrayLike) -> NDArray[np.float64]:
    """The non-dominated points."""
    points = np.asarray(points, dtype=np.float64)
    return points[non_dominated(points)]


def hypervolume(points: ArrayLike, reference_point: ArrayLike) -> float:
    """The volume between the reference point and the front (Zitzler and Thiele, 1999).

    Exact where `is_exact` says so, else moocore's deterministic approximation. A point that does
    not exceed the reference point in every objective contributes nothing.
    """
    points = np.asarray(points, dtype=np.float64)
    exact = is_exact(len(points), points.shape[1])
    reference = np.asarray(reference_point, dtype=np.float64)
    points = front(points)
    points = points[(points > reference).all(1)]
    if not len(points):
        return 0.0
    volume = moocore.hypervolume if exact else moocore.hv_approx
    return float(volume(points, ref=reference, maximise=True))


def is_exact(num_points: int, num_objectives: int) -> bool:
    """Whether the hypervolume of so many points is computed exactly."""
    return num_objectives <= EXACT_OBJECTIVES or num_points <= EXACT_POINTS


def sparsity(points: ArrayLike) -> float:
    """Mean squared gap between neighbours on the front, summed over objectives.

    Less is denser; a front of one point has none. (Xu et al., PG-MORL, 2020, eq. 4.)
    """
    points = np.sort(front(points), axis=0)
    return float(np.square(np.diff(points, axis=0)).sum() / max(len(points) - 1, 1))


def expected_utility(points: ArrayLike, tradeoffs: ArrayLike) -> float:
    """Mean over trade-offs (k, m) of the best w . r among the points (Zintgraf et al., 2015)."""
    points = front(points)
    if not len(points):
        return float("-inf")
    return float((np.asarray(tradeoffs, dtype=np.float64) @ points.T).max(1).mean())


def cardinality(points: ArrayLike) -> int:
    """How many points the front has."""
    return int(non_dominated(points).sum())


def igd_plus(points: ArrayLike, reference_front: ArrayLike) -> float:
    """Mean distance by which the front A falls short of a reference front Z (Ishibuchi, 2015).

    1/|Z| sum over z in Z of min over a in A of sqrt(sum_k max(z_k - a_k, 0)^2), in the units of the
    returns: 0 where every point of Z is reached or exceeded.
    """
    reference = np.asarray(reference_front, dtype=np.float64)
    points = front(points)
    return float(moocore.igd_plus(points, ref=reference, maximise=True)) if len(points) else np.inf


def obeys(
    points: ArrayLike, tradeoffs: ArrayLike, tolerance: float = OBEDIENCE_TOLERANCE
) -> NDArray[np.bool_]:
    """(n,) Whether the policy of each trade-off is the best of them all for it, or as good as.

    Point r_i is what the policy of trade-off w_i reached; both are (n, m). With u_ij = w_i . r_j,

        i obeys where  max_j u_ij - u_ii <= tolerance * (max_j u_ij - min_j u_ij).

    The left side is what trade-off i loses by using its own policy (the utility loss of Zintgraf
    et al., 2015, within the set), the bracket what the choice of a policy decides at all. Policies
    that tie all obey. A point that is not finite does not obey, and is not compared with.
    """
    points = np.asarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(1)
    result = np.zeros(len(points), dtype=np.bool_)
    if finite.any():
        utility = np.asarray(tradeoffs, dtype=np.float64)[finite] @ points[finite].T
        most, least = utility.max(1), utility.min(1)
        result[finite] = most - utility.diagonal() <= tolerance * (most - least)
    return result


def obedience(
    points: ArrayLike, tradeoffs: ArrayLike, tolerance: float = OBEDIENCE_TOLERANCE
) -> float:
    """The share of trade-offs that `obeys` holds for: does the family do what it is asked?

    A family of equal policies obeys by having no choice: read it beside the hypervolume.
    """
    return float(obeys(points, tradeoffs, tolerance).mean())
