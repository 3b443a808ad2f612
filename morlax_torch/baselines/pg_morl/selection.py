"""The task selection of PG-MORL (Xu et al., 2020): what to train for the best front."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...evaluation import pareto
from .population import exceeding

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def select(
    archive: ArrayLike, predicted: ArrayLike, number: int, reference: ArrayLike, alpha: float
) -> Indices:
    """Return the indices (number,) of the candidates to train, in the order of their selection.

    The greedy task selection: each time, select the candidate whose predicted returns (c, m), added
    to the front of the archive (n, m), give the largest hypervolume - alpha * sparsity, and add its
    prediction to the archive. Only returns that exceed the reference point (m,) in every objective
    are on the front. They are measured from that point, and each objective is divided by the
    largest excess of the archive (of the predictions, if the archive has none), so that alpha has
    no unit.

    Predictions that add nothing tie. Of these, the ones that would need the least improvement to
    add hypervolume come first. Predictions that are not finite are not selected. If there are fewer
    than `number` others, all are returned.
    """
    reference = np.asarray(reference, np.float64)
    front = np.asarray(archive, np.float64) - reference
    front = front[exceeding(front)]
    points = np.asarray(predicted, np.float64) - reference
    finite = np.flatnonzero(np.isfinite(points).all(1))
    if not len(finite):
        return finite
    points = points[finite]
    scale = np.abs(front if len(front) else points).max(0)
    scale[scale == 0] = 1
    front, points = front / scale, points / scale
    front = front[pareto.non_dominated(front)]
    return finite[greedy(front, points, min(number, len(points)), alpha)]


def greedy(front: Array, points: Array, number: int, alpha: float) -> list[int]:
    """Select `number` of the points (c, m), as `select` does, relative to the reference point.

    As the front grows, a point adds less and less hypervolume, so that an old gain is an upper
    bound. It is enough to update the gain of the best point until the best one is up to date.
    """
    chosen: list[int] = []
    lacking = shortfalls(points, front)
    gains = np.zeros(len(points))
    gains[lacking < 0] = gained(points[lacking < 0], front)
    while len(chosen) < number:
        adding = lacking < 0
        costs = np.zeros(len(points))
        costs[adding] = alpha * (sparsities(points[adding], front) - pareto.sparsity(front))
        scores = np.where(adding, gains - costs, 0)
        scores[chosen] = -np.inf
        current = ~adding
        while not current[best := int(np.lexsort((lacking, -scores))[0])]:
            gains[best] = gained(points[[best]], front)[0]
            scores[best] = gains[best] - costs[best]
            current[best] = True
        chosen.append(best)
        if adding[best]:
            point = points[best]
            front = np.concatenate([front[(front > point).any(1)], point[None]])
            lacking = np.maximum(lacking, (point - points).min(1))
    return chosen


def shortfalls(points: Array, front: Array) -> Array:
    """Return the improvement (c,) in all objectives that points (c, m) need to add hypervolume.

    It is negative for points that add to the front (n, m) already.
    """
    least = (front - points[:, None]).min(-1)  # (c, n)
    return np.maximum(least.max(1, initial=-np.inf), -points.min(1))


def sparsities(points: Array, front: Array) -> Array:
    """Compute the sparsity (c,) of the front (n, m) after each of the points (c, m) is added."""
    dominated = np.all(front <= points[:, None], -1)  # (c, n)
    # a dominated value becomes a copy of the point, which has no gap to it
    joined = np.where(dominated[..., None], points[:, None], front)
    joined = np.sort(np.concatenate([joined, points[:, None]], 1), 1)
    squares = np.square(np.diff(joined, axis=1)).sum((1, 2))
    return squares / np.maximum((~dominated).sum(1), 1)


def gained(points: Array, front: Array) -> Array:
    """Compute the hypervolume (c,) that points (c, m) add to a front; each must add some."""
    zero = np.zeros(points.shape[1])
    covered = (pareto.hypervolume(np.minimum(front, point), zero) for point in points)
    return points.prod(1) - np.fromiter(covered, np.float64, len(points))
