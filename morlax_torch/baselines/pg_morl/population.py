"""PG-MORL: which policies stay, which are trained next, and how their returns would change.

Xu et al., 2020, sections 3.3 and 3.4. Objectives are maximized and may differ in unit: where the
authors' code has constants in units of their rewards, objectives are scaled by the returns.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...evaluation.pareto import hypervolume, non_dominated, sparsity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

LLOYD_STEPS = 20
CANDIDATE_ANGLE = np.pi / 4  # radians

# predictions
REACH = 0.1  # first reach of a neighborhood, relative to the range of the returns
DEVIATION = 0.3  # standard deviation of the Gaussian, relative to the reach
DIFFERENT_TRADEOFFS = 4  # as many as the model has parameters
DECIMALS = 5  # trade-offs that are equal after rounding to so many do not differ
MOST_NEIGHBORS = 128  # bounds the time of a fit
TRIMMED = 10  # of so many changes, the least and the greatest are outliers

# Bounds and start of A, a, b and c, for changes scaled to [0, 1] and weights in [0, 1].
LOWEST = np.array([0.0, 0.1, -5.0, -1.0])
HIGHEST = np.array([1.0, 20.0, 5.0, 2.0])
START = np.array([0.5, 5.0, 0.5, 0.5])
SOFT = 0.1  # scaled residual at which the loss turns from quadratic to linear


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


def performance_buffer(returns: Array, reference: Array, directions: Array, size: int) -> Indices:
    """Return the indices (k,) of the policies that stay in the population.

    Each policy, with returns (n, m), falls into the bin whose direction (B, m) is nearest in angle,
    seen from the reference point (m,). Each bin keeps the `size` policies farthest from that point.
    Policies that do not exceed it in every objective are dropped. Indices are sorted by bin, then
    from far to near. Each objective is divided by its largest excess over the reference point.
    """
    excess = returns - reference
    kept = np.flatnonzero(exceeding(excess))
    if not len(kept):
        return kept
    excess = excess[kept] / excess[kept].max(0)
    bins = (excess @ directions.T).argmax(1)
    order = np.lexsort((-np.linalg.norm(excess, axis=1), bins))
    ranks = np.arange(len(order)) - np.searchsorted(bins[order], bins[order])
    return kept[order[ranks < size]]


def pareto_archive(returns: Array, most: int) -> Indices:
    """Return the indices (k,) of the policies that stay in the external Pareto archive, sorted.

    Those are all with returns (n, m) that none dominates. Of more than `most`, the most crowded are
    dropped one by one: those with the smallest distance to another, of equal ones the smaller
    second distance, and so on (as SPEA2 truncates its archive; Zitzler et al., 2001). Distances are
    relative to the range of each objective.
    """
    kept = np.flatnonzero(non_dominated(returns))
    if len(kept) <= most:
        return kept
    extent = np.ptp(returns[kept], axis=0)
    scaled = returns[kept] / np.where(extent > 0, extent, 1)
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


def candidate_weights(current: Array, number: int) -> tuple[Array, Mask]:
    """Return trade-offs (p, number, m) near the current ones (p, m), and a mask (p, number).

    Candidates lie within 45 degrees of the trade-off that a policy was last trained with, and sum
    to 1. The mask is False for candidates to ignore. With two objectives candidates are evenly
    spaced in angle, and those with a negative weight are masked. With more, the first candidate is
    the current trade-off, and the others are even directions turned towards it.
    """
    current = unit(current)
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
    archive: Array, predicted: Array, number: int, reference: Array, alpha: float
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
    front = archive - reference
    front = front[exceeding(front)]
    points = predicted - reference
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


def predict(
    before: Array,  # returns (h, m) at the start of each stretch of training so far
    weights: Array,  # trade-offs (h, m) of the stretches
    change: Array,  # changes (h, m) of the returns in the stretches
    points: Array,  # current returns (p, m) of the policies
    candidates: Array,  # trade-offs (p, c, m)
) -> Array:
    """Predict the returns (p, c, m) of p policies after training with c candidate trade-offs each.

    Each policy and objective has its own model of the change over the weight x of that objective,

        f(x) = A (e^{a(x-b)} - 1) / (e^{a(x-b)} + 1) + c = A tanh(a(x-b) / 2) + c,

    fitted to the stretches that started near the policy (see `neighborhood`), in units of the range
    of their changes without outliers. The model only rises: more weight never means less
    improvement. Stretches that are not finite are ignored. Without history, no change is predicted.
    """
    finite = np.isfinite(before).all(1) & np.isfinite(change).all(1)
    before, weights, change = before[finite], weights[finite], change[finite]
    predicted = points[:, None] + np.zeros_like(candidates)
    if not len(before):
        return predicted
    extent = np.ptp(np.concatenate([before, before + change]), axis=0)
    extent[extent == 0] = np.inf  # without a range there is no unit: the objective is ignored
    _, kinds = np.unique(weights.round(DECIMALS), axis=0, return_inverse=True)
    for i, point in enumerate(points):
        nearest, closeness = neighborhood(np.abs(point - before) / extent, kinds)
        for k in range(len(point)):
            changes = change[nearest, k]
            low, size = trimmed_range(changes)
            scaled = (changes - low) / (size or 1.0)
            model = fitted(weights[nearest, k], scaled, closeness)
            predicted[i, :, k] += low + size * hyperbolic(model, candidates[i, :, k])
    return predicted


def neighborhood(away: Array, kinds: Indices) -> tuple[Indices, Array]:
    """Return the stretches (n,) that started near a policy, and their closeness (n,).

    They are `away` (h, m) from the policy, relative to the range of each objective. A neighborhood
    reaches 0.1 in every objective and doubles until it holds four `kinds` (h,) of trade-offs, or
    all stretches if there are fewer. The nearest 128 of them count.

    Closeness is a Gaussian of the distance, with a standard deviation of 0.3 of the reach, divided
    by its value for the nearest stretch. Without the division, residuals of distant stretches would
    be too small for the loss to turn linear, and outliers would not be damped.
    """
    distances = away.max(1)
    order = distances.argsort(kind="stable")
    _, firsts = np.unique(kinds[order], return_index=True)  # the nearest of each kind
    rank = np.sort(firsts)[DIFFERENT_TRADEOFFS - 1] if len(firsts) >= DIFFERENT_TRADEOFFS else -1
    reach = REACH
    while reach < distances[order[rank]]:
        reach *= 2
    squares = np.square(away).sum(1)
    inside = np.flatnonzero(distances <= reach)
    nearest = inside[squares[inside].argsort(kind="stable")[:MOST_NEIGHBORS]]
    further = squares[nearest] - squares[nearest[0]]
    return nearest, np.exp(-further / (2 * (DEVIATION * reach) ** 2))


def trimmed_range(values: Array) -> tuple[float, float]:
    """Return the least of the values (n,) and their range, without a tenth at either end."""
    ordered, trim = np.sort(values), (len(values) - 1) // TRIMMED
    low, high = ordered[trim], ordered[-1 - trim]
    if low == high:  # then those are no outliers
        low, high = ordered[0], ordered[-1]
    return float(low), float(high - low)


def hyperbolic(parameters: Array, x: Array) -> Array:
    """Compute A tanh(a(x - b) / 2) + c for parameters (4,) and x (n,)."""
    A, a, b, c = parameters
    return A * np.tanh(a * (x - b) / 2) + c


def fitted(x: Array, y: Array, closeness: Array) -> Array:
    """Fit the model (4,) to y at x, (n,) each; soft-L1 losses of residuals times closeness (n,)."""
    return least_squares(
        lambda parameters: closeness * (hyperbolic(parameters, x) - y),
        START,
        bounds=(LOWEST, HIGHEST),
        loss="soft_l1",
        f_scale=SOFT,
    ).x
