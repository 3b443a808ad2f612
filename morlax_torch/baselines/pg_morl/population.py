"""Population and archive of PG-MORL: which policies stay, and which are trained next, with what.

Xu et al., 2020, sections 3.3 and 3.4. Objectives are maximized and may differ in unit: where the
authors' code has constants in units of their rewards, objectives are scaled by the returns.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...evaluation.pareto import hypervolume, non_dominated, sparsity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

LLOYD_STEPS = 20
CANDIDATE_ANGLE = np.pi / 4  # radians


def directions(number: int, num_objectives: int) -> Array:
    """Return unit vectors (number, m) that divide the positive orthant evenly.

    With two objectives they are the centers of equal angles, from the second axis to the first.
    With more, they are the centers of clusters of uniform directions (Lloyd's algorithm, with a
    fixed random seed).
    """
    if num_objectives == 2:
        angles = (np.arange(number) + 0.5) * (np.pi / 2 / number)
        return np.stack([np.sin(angles), np.cos(angles)], -1)
    normal = np.random.default_rng(0).normal(size=(100 * number, num_objectives))
    samples = unit(np.abs(normal))  # uniform in the positive orthant
    centers = samples[:number]
    for _ in range(LLOYD_STEPS):
        nearest = (samples @ centers.T).argmax(1)
        sums = [np.bincount(nearest, sample, number) for sample in samples.T]
        centers = unit(centers + np.stack(sums, -1))  # a center without samples stays
    return centers


def unit(vectors: Array) -> Array:
    """Scale vectors (..., m) to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def performance_buffer(
    returns: ArrayLike, reference: ArrayLike, directions: ArrayLike, size: int
) -> Indices:
    """Return the indices (k,) of the policies that stay in the population.

    Each policy, with returns (n, m), falls into the bin whose direction (B, m) is nearest in angle,
    seen from the reference point (m,). Each bin keeps the `size` policies farthest from that point.
    Policies that do not exceed it in every objective are dropped. Indices are sorted by bin, then
    from far to near. Each objective is divided by its largest excess over the reference point.
    """
    excess = np.asarray(returns, np.float64) - np.asarray(reference, np.float64)
    kept = np.flatnonzero(exceeding(excess))
    if not len(kept):
        return kept
    excess = excess[kept] / excess[kept].max(0)
    bins = (excess @ np.asarray(directions, np.float64).T).argmax(1)
    order = np.lexsort((-np.linalg.norm(excess, axis=1), bins))
    ranks = np.arange(len(order)) - np.searchsorted(bins[order], bins[order])
    return kept[order[ranks < size]]


def pareto_archive(returns: ArrayLike, most: int) -> Indices:
    """Return the indices (k,) of the policies that stay in the external Pareto archive, sorted.

    Those are all with returns (n, m) that none dominates. Of more than `most`, the most crowded are
    dropped one by one: those with the smallest distance to another, of equal ones the smaller
    second distance, and so on (as SPEA2 truncates its archive; Zitzler et al., 2001). Distances are
    relative to the range of each objective.
    """
    points = np.asarray(returns, np.float64)
    kept = np.flatnonzero(non_dominated(points))
    if len(kept) <= most:
        return kept
    extent = np.ptp(points[kept], axis=0)
    scaled = points[kept] / np.where(extent > 0, extent, 1)
    distances = np.linalg.norm(scaled[:, None] - scaled, axis=-1)
    while len(kept) > most:
        nearest = np.sort(distances, axis=1)
        crowded = np.lexsort(nearest.T[::-1])[0]
        kept = np.delete(kept, crowded)
        distances = np.delete(np.delete(distances, crowded, 0), crowded, 1)
    return kept


def exceeding(excess: Array) -> Mask:
    """Return (n,) bool: True where excess (n, m) is finite and positive in every objective."""
    return np.all(np.isfinite(excess) & (excess > 0), axis=1)


def candidate_weights(current: ArrayLike, number: int) -> tuple[Array, Mask]:
    """Return trade-offs (p, number, m) near the current ones (p, m), and a mask (p, number).

    Candidates lie within 45 degrees of the trade-off that a policy was last trained with, and sum
    to 1. The mask is False for candidates to ignore. With two objectives candidates are evenly
    spaced in angle, and those with a negative weight are masked. With more, the first candidate is
    the current trade-off, and the others are even directions turned towards it.
    """
    current = unit(np.asarray(current, np.float64))
    if current.shape[1] == 2:
        steps = np.arange(number) - (number - 1) / 2
        offsets = steps * (2 * CANDIDATE_ANGLE / max(number - 1, 1))
        angles = np.arctan2(current[:, 1], current[:, 0])[:, None] + offsets
        weights = np.stack([np.cos(angles), np.sin(angles)], -1)
        valid = np.all(weights >= -1e-7, axis=-1)  # rounding of a corner
        weights = weights.clip(0)
    else:
        others = turned_towards(current, directions(max(number - 1, 1), current.shape[1]))
        weights = np.concatenate([current[:, None], others], 1)[:, :number]
        valid = np.ones(weights.shape[:2], np.bool_)
    return weights / weights.sum(-1, keepdims=True), valid


def turned_towards(centers: Array, others: Array) -> Array:
    """Turn unit vectors (k, m) towards each of the centers (p, m), and return them (p, k, m).

    All angles from a center shrink by one factor, so that different vectors stay different: the
    corner of the simplex farthest from that center would be 45 degrees away.
    """
    farthest = np.arccos(centers.min(1).clip(0, 1))
    share = (CANDIDATE_ANGLE / farthest)[:, None]
    angles = np.arccos((centers @ others.T).clip(-1, 1))
    tangents = others - np.cos(angles)[..., None] * centers[:, None]
    tangents /= np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-12)
    angles = (share * angles)[..., None]
    return np.cos(angles) * centers[:, None] + np.sin(angles) * tangents


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
    front = front[non_dominated(front)]
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
        costs[adding] = alpha * (sparsities(points[adding], front) - sparsity(front))
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
    covered = (hypervolume(np.minimum(front, point), zero) for point in points)
    return points.prod(1) - np.fromiter(covered, np.float64, len(points))
