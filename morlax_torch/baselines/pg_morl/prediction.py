"""The prediction of PG-MORL: how the returns of a policy would change under a trade-off.

Xu et al., 2020, section 3.4. `population` says how objectives are scaled.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

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


def predict(
    before: ArrayLike,  # returns (h, m) at the start of each stretch of training so far
    weights: ArrayLike,  # trade-offs (h, m) of the stretches
    change: ArrayLike,  # changes (h, m) of the returns in the stretches
    points: ArrayLike,  # current returns (p, m) of the policies
    candidates: ArrayLike,  # trade-offs (p, c, m)
) -> Array:
    """Predict the returns (p, c, m) of p policies after training with c candidate trade-offs each.

    Each policy and objective has its own model of the change over the weight x of that objective,

        f(x) = A (e^{a(x-b)} - 1) / (e^{a(x-b)} + 1) + c = A tanh(a(x-b) / 2) + c,

    fitted to the stretches that started near the policy (see `neighborhood`), in units of the range
    of their changes without outliers. The model only rises: more weight never means less
    improvement. Stretches that are not finite are ignored. Without history, no change is predicted.
    """
    before, weights, change, points, candidates = (
        np.asarray(array, np.float64) for array in (before, weights, change, points, candidates)
    )
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
