"""The rules of PG-MORL: keep a population, predict its returns, and select what to train next.

Xu et al., 2020, "Prediction-Guided Multi-Objective Reinforcement Learning for Continuous Robot
Control". Every objective is maximized and may have its own unit: where the authors' code has
constants in units of their rewards, these rules scale each objective by the given returns.
"""

import math

import moocore
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

SAMPLES_PER_DIRECTION = 100
LLOYD_STEPS = 20

CANDIDATE_ANGLE = np.pi / 4  # radians

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
FIT_STEPS = 50
FIT_TOLERANCE = 1e-6  # relative decrease of the loss at which a fit ends

EXACT_OBJECTIVES = 4  # with more, exact hypervolumes of all candidates may take minutes
RAYS = 128  # of each estimated hypervolume


def directions(number: int, num_objectives: int) -> Array:
    """Return unit vectors (number, m) that divide the positive orthant evenly.

    With two objectives they are the centers of equal angles, from the second axis to the first.
    With more, they are the centers of clusters of uniform directions (Lloyd's algorithm, with a
    fixed random seed). The authors' code uses a grid of trade-offs instead, which is less even in
    angle and exists for few numbers only.
    """
    if num_objectives == 2:
        angles = (np.arange(number) + 0.5) * (np.pi / 2 / number)
        return np.stack([np.sin(angles), np.cos(angles)], -1)
    samples = uniform_directions(SAMPLES_PER_DIRECTION * number, num_objectives)
    centers = samples[:number]
    for _ in range(LLOYD_STEPS):
        nearest = (samples @ centers.T).argmax(1)
        sums = [np.bincount(nearest, sample, number) for sample in samples.T]
        centers = unit(centers + np.stack(sums, -1))  # a center without samples stays
    return centers


def uniform_directions(number: int, num_objectives: int) -> Array:
    """Draw unit vectors (number, m), uniform in the positive orthant, always the same."""
    return unit(np.abs(np.random.default_rng(0).normal(size=(number, num_objectives))))


def unit(vectors: Array) -> Array:
    """Scale vectors (..., m) to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def performance_buffer(
    returns: ArrayLike, reference: ArrayLike, directions: ArrayLike, size: int
) -> Indices:
    """Return the indices (k,) of the policies that stay in the population.

    Each policy falls into the bin whose direction is nearest in angle, seen from the reference
    point. Each bin keeps the `size` policies farthest from the reference point. Policies that do
    not exceed it in every objective are dropped. Indices are sorted by bin, then from far to near.

    Unlike in the authors' code, each objective is divided by its largest excess over the reference
    point first, so that units do not change the bins.

    Args:
        returns: Returns (n, m) of all policies.
        reference: Reference point (m,).
        directions: Unit vectors (B, m), one per bin.
        size: Most policies per bin.
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


def exceeding(excess: Array) -> Mask:
    """Return (n,) bool: True where excess (n, m) is finite and positive in every objective."""
    return np.all(np.isfinite(excess) & (excess > 0), axis=1)


def candidate_weights(current: ArrayLike, number: int) -> tuple[Array, Mask]:
    """Return trade-offs (p, number, m) near the current ones (p, m), and a mask (p, number).

    Candidates lie within 45 degrees of the trade-off that a policy was last trained with, and sum
    to 1. The mask is False for candidates to ignore.

    With two objectives candidates are evenly spaced in angle, as in the authors' code. Those that
    would have a negative weight are masked. With more objectives the first candidate is the current
    trade-off, and the others are even directions turned towards it (see `turned_towards`); none is
    masked. The authors' code draws these others at random from a grid.
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

    All angles from a center shrink by one factor, at which the corner of the simplex farthest from
    that center would be 45 degrees away. So different vectors stay different.
    """
    farthest = np.arccos(centers.min(1).clip(0, 1))
    share = (CANDIDATE_ANGLE / farthest)[:, None]
    angles = np.arccos((centers @ others.T).clip(-1, 1))
    tangents = others - np.cos(angles)[..., None] * centers[:, None]
    tangents /= np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-12)
    angles = (share * angles)[..., None]
    return np.cos(angles) * centers[:, None] + np.sin(angles) * tangents


def predict(
    before: ArrayLike,
    weights: ArrayLike,
    change: ArrayLike,
    points: ArrayLike,
    candidates: ArrayLike,
) -> Array:
    """Predict the returns (p, c, m) of p policies after training with c candidate trade-offs each.

    Args:
        before: Returns (h, m) at the start of each stretch of training so far.
        weights: Trade-offs (h, m) of the stretches.
        change: Changes (h, m) of the returns in the stretches.
        points: Current returns (p, m) of the policies.
        candidates: Trade-offs (p, c, m).

    Each policy and objective has its own model of the change over the weight x of that objective,

        f(x) = A (e^{a(x-b)} - 1) / (e^{a(x-b)} + 1) + c = A tanh(a(x-b) / 2) + c,

    fitted to the stretches that started near the policy (see `neighborhoods`). The model only
    rises: more weight never means less improvement. Stretches that are not finite are ignored.
    Without history, no change is predicted.

    The bounds of a and b are the authors'. Their bounds of A and c, and the residual at which their
    soft-L1 loss turns linear, are in units of their rewards. Here they follow the range of the
    changes in the neighborhood, without outliers (see `trimmed_range`): A is at most that range, c
    at most one range above or below it, and the loss turns linear at a tenth of it.
    """
    before, weights, change, points, candidates = (
        np.asarray(array, np.float64) for array in (before, weights, change, points, candidates)
    )
    finite = np.isfinite(before).all(1) & np.isfinite(change).all(1)
    before, weights, change = before[finite], weights[finite], change[finite]
    if not len(before) or not len(points):
        return points[:, None] + np.zeros_like(candidates)
    nearest, closeness = neighborhoods(before, weights, change, points)
    x, y = (np.moveaxis(array[nearest], 1, 2) for array in (weights, change))  # (p, m, k)
    closeness = np.broadcast_to(closeness[:, None], y.shape)
    low, extent = trimmed_range(y, closeness > 0)
    scaled = (y - low[..., None]) / np.where(extent > 0, extent, 1)[..., None]
    size = y.shape[-1]
    fits = fitted(*(array.reshape(-1, size) for array in (x, scaled, closeness)))
    fits = fits.reshape(*low.shape, 1, len(START))
    predicted = hyperbolic(fits, np.moveaxis(candidates, 1, 2))
    return points[:, None] + np.moveaxis(low[..., None] + extent[..., None] * predicted, 2, 1)


def neighborhoods(
    before: Array, weights: Array, change: Array, points: Array
) -> tuple[Indices, Array]:
    """Return the stretches (p, k) that started near each policy, and their closeness (p, k).

    Distances are relative to the range of each objective over the starts and ends of all stretches.
    (The authors' code divides by the returns of the policy, which may be near zero.) A neighborhood
    reaches 0.1 in every objective and doubles until it holds four different trade-offs, or all
    stretches if there are fewer. At most its 128 nearest stretches count.

    Closeness is a Gaussian of the distance, with a standard deviation of 0.3 of the reach, divided
    by its value for the nearest stretch. Without the division, residuals of distant stretches would
    be too small for the loss to turn linear, and outliers would not be damped. Closeness is 0 for
    stretches outside the neighborhood, which fill the rows.
    """
    ends = np.concatenate([before, before + change])
    extent = np.ptp(ends, axis=0)
    extent[extent == 0] = np.inf  # without a range there is no unit: the objective is ignored
    away = np.abs(points[:, None] - before) / extent
    distances = away.max(-1)
    needed = distances_of_different(distances, weights)
    reach = np.full(len(points), REACH)
    while (short := reach < needed).any():
        reach[short] *= 2
    squares = np.square(away).sum(-1)
    squares[distances > reach[:, None]] = np.inf
    size = min(MOST_NEIGHBORS, int(np.isfinite(squares).sum(1).max()))
    nearest = np.argpartition(squares, size - 1, axis=1)[:, :size]
    squares = np.take_along_axis(squares, nearest, 1)
    squares -= squares.min(1, keepdims=True)
    return nearest, np.exp(-squares / (2 * np.square(DEVIATION * reach[:, None])))


def distances_of_different(distances: Array, weights: Array) -> Array:
    """Return the reach (p,) that includes four different trade-offs, or all stretches if fewer.

    Args:
        distances: Distances (p, h) of stretches from policies.
        weights: Trade-offs (h, m) of the stretches.
    """
    _, kinds = np.unique(weights.round(DECIMALS), axis=0, return_inverse=True)
    order = np.argsort(kinds, kind="stable")
    starts = np.searchsorted(kinds[order], np.arange(kinds.max() + 1))
    of_kinds = np.minimum.reduceat(distances[:, order], starts, axis=1)
    if of_kinds.shape[1] < DIFFERENT_TRADEOFFS:
        return distances.max(1)
    return np.partition(of_kinds, DIFFERENT_TRADEOFFS - 1, axis=1)[:, DIFFERENT_TRADEOFFS - 1]


def trimmed_range(values: Array, present: Mask) -> tuple[Array, Array]:
    """Return the least value (...,) and the range (...,) of the present values (..., k).

    About a tenth of the values is left out at either end as outliers, unless all others are equal.
    """
    ordered = np.sort(np.where(present, values, np.inf), -1)
    last = present.sum(-1, keepdims=True) - 1
    trim = last // TRIMMED

    def ends(first: NDArray[np.intp], last: NDArray[np.intp]) -> tuple[Array, Array]:
        low, high = (np.take_along_axis(ordered, index, -1)[..., 0] for index in (first, last))
        return low, high - low

    low, extent = ends(trim, last - trim)
    all_low, all_extent = ends(np.zeros_like(last), last)
    return np.where(extent > 0, low, all_low), np.where(extent > 0, extent, all_extent)


def hyperbolic(parameters: Array, x: Array) -> Array:
    """Compute A tanh(a(x - b) / 2) + c for parameters (..., 4) and x (...)."""
    A, a, b, c = np.moveaxis(parameters, -1, 0)
    return A * np.tanh(a * (x - b) / 2) + c


def jacobian(parameters: Array, x: Array) -> Array:
    """Return the derivatives (..., 4) of `hyperbolic` by its parameters."""
    A, a, b, _ = np.moveaxis(parameters, -1, 0)
    t = np.tanh(a * (x - b) / 2)
    slope = A * (1 - t * t) / 2
    return np.stack([t, slope * (x - b), -slope * a, np.ones_like(t)], -1)


def fitted(x: Array, y: Array, closeness: Array) -> Array:
    """Fit n hyperbolic models at once, each to its own k points, and return parameters (n, 4).

    Minimizes sum_i L(closeness_i (f(x_i) - y_i)) within the bounds, where L is the soft-L1 loss

        L(r) = s^2 (sqrt(1 + (r / s)^2) - 1),

    by Levenberg-Marquardt steps on iteratively reweighted least squares. A fit ends when a step
    improves its loss no more than the tolerance. All arguments are (n, k).
    """
    result = np.tile(START, (len(x), 1))
    running = np.arange(len(x))
    parameters, damping = result.copy(), np.full(len(x), 1e-2)
    residuals = closeness * (hyperbolic(parameters[:, None], x) - y)
    loss = soft_l1(residuals)
    for _ in range(FIT_STEPS):
        step = damped_step(parameters, x, residuals, closeness, damping)
        trial = np.clip(parameters + step, LOWEST, HIGHEST)
        trial_residuals = closeness * (hyperbolic(trial[:, None], x) - y)
        trial_loss = soft_l1(trial_residuals)
        better = trial_loss < loss
        ended = better & (trial_loss > (1 - FIT_TOLERANCE) * loss) | (damping > 1e6)
        parameters[better] = trial[better]
        residuals[better] = trial_residuals[better]
        loss[better] = trial_loss[better]
        damping = np.maximum(damping * np.where(better, 0.2, 5), 1e-9)
        result[running] = parameters
        if ended.any():
            running = running[~ended]
            parameters, damping, residuals, loss, x, y, closeness = (
                array[~ended] for array in (parameters, damping, residuals, loss, x, y, closeness)
            )
        if not len(running):
            break
    return result


def soft_l1(residuals: Array) -> Array:
    """Compute the loss (n,) of residuals (n, k)."""
    return np.square(SOFT) * (np.sqrt(1 + np.square(residuals / SOFT)) - 1).sum(-1)


def damped_step(
    parameters: Array, x: Array, residuals: Array, closeness: Array, damping: Array
) -> Array:
    """Return a Levenberg-Marquardt step (n, 4) of each fit.

    A parameter that is at a bound and would cross it is held, so that the others move as they would
    without it.

    Args:
        parameters: Parameters (n, 4) within the bounds.
        x: Weights (n, k) of the objective.
        residuals: Residuals (n, k), multiplied by closeness.
        closeness: Factors (n, k) of the residuals.
        damping: Shares (n,) of the diagonal to add to it.
    """
    slopes = jacobian(parameters[:, None], x) * closeness[..., None]
    robust = 1 / np.sqrt(1 + np.square(residuals / SOFT))
    gradient = ((robust * residuals)[:, None] @ slopes)[:, 0]
    squares = slopes.mT @ (robust[..., None] * slopes)
    held = (parameters <= LOWEST) & (gradient > 0) | (parameters >= HIGHEST) & (gradient < 0)
    free = ~held
    squares *= free[:, None] & free[..., None]
    axis = np.arange(len(START))
    # the constant keeps the system solvable where the data do not determine a parameter
    squares[:, axis, axis] += damping[:, None] * squares[:, axis, axis] + 1e-12
    step = np.linalg.solve(squares, np.where(free, -gradient, 0)[..., None])
    return step[..., 0].astype(np.float64, copy=False)


def select(
    archive: ArrayLike, predicted: ArrayLike, number: int, reference: ArrayLike, alpha: float
) -> Indices:
    """Return the indices (number,) of the candidates to train, in the order of their selection.

    The greedy task selection: each time, select the candidate whose predicted returns, added to the
    front of the archive, give the largest

        hypervolume - alpha * sparsity

    and add its prediction to the archive. Sparsity is the mean squared gap between neighbors on the
    front, summed over objectives. Only returns that exceed the reference point in every objective
    are on the front. They are measured from the reference point, and each objective is divided by
    the largest excess of the archive (of the predictions, if the archive has none), so that alpha
    has no unit.

    Predictions that add nothing tie. Of these, the ones that would need the least improvement to
    add hypervolume come first (in the authors' code, the first in the list). Predictions that are
    not finite are not selected. If there are fewer than `number` others, all are returned.

    Args:
        archive: Returns (n, m) of the policies so far.
        predicted: Predicted returns (c, m) of the candidates.
        number: Number of candidates to select.
        reference: Reference point (m,) of the hypervolume.
        alpha: Weight of the sparsity.
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
    if len(front):
        front = front[moocore.is_nondominated(front, maximise=True)]
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

    It is negative for points that add to the front (n, m) already. All are relative to the
    reference point.
    """
    least = front[:, 0] - points[:, :1]
    for objective in range(1, points.shape[1]):
        np.minimum(least, front[:, objective] - points[:, objective, None], out=least)
    return np.maximum(least.max(1, initial=-np.inf), -points.min(1))


def sparsity(front: Array) -> float:
    """Compute the mean squared gap between neighbors on a front (n, m), summed over objectives."""
    gaps = np.diff(np.sort(front, axis=0), axis=0)
    return float(np.square(gaps).sum() / max(len(gaps), 1))


def sparsities(points: Array, front: Array) -> Array:
    """Compute the sparsity (c,) of the front (n, m) after each of the points (c, m) is added."""
    columns = list(zip(points.T, front.T, strict=True))
    dominated = np.ones((len(points), len(front)), np.bool_)
    for point, values in columns:
        dominated &= values <= point[:, None]
    squares = np.zeros(len(points))
    for point, values in columns:
        # a dominated value becomes a copy of the point, which has no gap to it
        joined = np.where(dominated, point[:, None], values)
        joined = np.sort(np.concatenate([joined, point[:, None]], 1), 1)
        squares += np.square(np.diff(joined, axis=1)).sum(1)
    return squares / np.maximum((~dominated).sum(1), 1)


def gained(points: Array, front: Array) -> Array:
    """Compute the hypervolume (c,) that each of the points (c, m) adds to a front (n, m).

    All are relative to the reference point. The points must add hypervolume. Exact for up to four
    objectives, else an estimate (see `volume_along_rays`).
    """
    num_objectives = points.shape[1]
    if num_objectives == 2:
        return area_gained(points, front)
    if num_objectives <= EXACT_OBJECTIVES:
        return np.array([volume_gained(point, front) for point in points])
    rays = uniform_directions(RAYS, num_objectives)
    return np.array([volume_along_rays(point, front, rays) for point in points])


def area_gained(points: Array, front: Array) -> Array:
    """Compute the areas (c,) that points (c, 2) add to the staircase below a front (n, 2)."""
    x, y = front[np.argsort(front[:, 0])].T
    left, right, height = np.append(0, x), np.append(x, np.inf), np.append(y, 0)
    widths = np.minimum(points[:, :1], right) - left
    heights = points[:, 1:] - height
    return (widths.clip(0) * heights.clip(0)).sum(1)


def volume_gained(point: Array, front: Array) -> float:
    """Compute the volume of the box below a point (m,) that lies above a front (n, m)."""
    box = float(point.prod())
    if not len(front):
        return box
    covered = np.minimum(front, point)
    return box - float(moocore.hypervolume(covered, ref=np.zeros(len(point)), maximise=True))


def volume_along_rays(point: Array, front: Array, rays: Array) -> float:
    """Estimate `volume_gained` from rays (k, m), uniform directions in the positive orthant.

    A ray from the point downwards leaves the volume once, after a length l. The volume is the mean
    of l^m times the volume of one orthant of the unit ball (Shang et al., 2020, "R2-Based
    Hypervolume Contribution Approximation").
    """
    m = len(point)
    lengths = (point / rays).min(1)
    if len(front):
        covered = np.minimum(front, point)
        covered = covered[moocore.is_nondominated(covered, maximise=True)]
        leaving = np.zeros((len(rays), len(covered)))
        for inverse, drop in zip((1 / rays).T, (point - covered).T, strict=True):
            np.maximum(leaving, inverse[:, None] * drop, out=leaving)
        lengths = np.minimum(lengths, leaving.min(1))
    orthant = math.pi ** (m / 2) / math.gamma(m / 2 + 1) / 2**m
    return orthant * float(np.mean(lengths**m))
