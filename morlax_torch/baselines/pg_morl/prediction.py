"""The prediction of PG-MORL: how the returns of a policy would change under a trade-off.

Xu et al., 2020, section 3.4. Every objective is maximized and may have its own unit: where the
authors' code has constants in units of their rewards, objectives are scaled by the returns.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

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
    rows = (array.reshape(-1, y.shape[-1]) for array in (x, scaled, closeness))
    fits = np.stack([fitted(*row) for row in zip(*rows, strict=True)])
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

    Stretches with trade-offs (h, m) are at `distances` (p, h) from policies.
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


def fitted(x: Array, y: Array, closeness: Array) -> Array:
    """Fit a hyperbolic model to k points, all (k,), and return its parameters (4,).

    Minimizes sum_i L(closeness_i (f(x_i) - y_i)) within the bounds, where L is the soft-L1 loss.
    """
    return least_squares(
        lambda parameters: closeness * (hyperbolic(parameters, x) - y),
        START,
        bounds=(LOWEST, HIGHEST),
        loss="soft_l1",
        f_scale=SOFT,
    ).x
