"""Statistics over training runs, in NumPy, mostly as in rliable (Agarwal et al., 2021).

Scores come as one array per task, with one score per run. Higher is better.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morlax_torch.evaluation import pareto

Array = NDArray[np.float64]

RESAMPLES = 2000  # of the bootstrap
CONFIDENCE = 0.95
QUARTILES = (0.25, 0.5, 0.75)


def best_so_far(x: ArrayLike, y: ArrayLike, grid: ArrayLike) -> Array:
    """Return the highest y so far at every point of a grid, 0 before the first evaluation.

    The curve is a step function: it keeps its value until a better evaluation, and after the last.

    Args:
        x: (E,) environment steps or seconds of the evaluations, ascending.
        y: (E,) hypervolumes.
        grid: (G,) points to return a value at.
    """
    best = np.maximum.accumulate(np.asarray(y, dtype=np.float64))
    return np.concatenate([[0.0], best])[np.searchsorted(x, grid, side="right")]


def band(curves: Sequence[tuple[ArrayLike, ArrayLike]]) -> tuple[Array, Array]:
    """Return all evaluation points (G,) of some curves (x, y), and the quartiles (3, G) there.

    The quartiles are over runs, of the best value so far, interpolated linearly between runs.
    """
    grid = np.unique(np.concatenate([np.asarray(x, dtype=np.float64) for x, _ in curves]))
    return grid, np.quantile([best_so_far(x, y, grid) for x, y in curves], QUARTILES, axis=0)


def interquartile_mean(scores: ArrayLike) -> Array:
    """Return the mean over the last axis without floor(n / 4) scores at each end.

    This is the trimmed mean at 25 % of Agarwal et al. (2021).
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=-1)
    n = ordered.shape[-1]
    return ordered[..., n // 4 : n - n // 4].mean(-1)


def profile(scores: ArrayLike, thresholds: ArrayLike) -> Array:
    """Return the share of scores (..., n) that exceed each threshold (T,), as (..., T).

    This is the run-score distribution of Agarwal et al. (2021), section 4.2.
    """
    ordered = np.asarray(scores, dtype=np.float64)[..., None]
    return (ordered > np.asarray(thresholds)).mean(-2)


def resampled(scores: Sequence[ArrayLike], resamples: int = RESAMPLES, seed: int = 0) -> Array:
    """Draw bootstrap samples, stratified by task: runs with replacement within each task.

    Args:
        scores: per task, the scores of its runs.
        resamples: B, the number of bootstrap samples.
        seed: random seed.

    Returns:
        (B, n) with n, the number of runs of all tasks; those of a task stay side by side.
    """
    random = np.random.default_rng(seed)
    drawn = []
    for task in scores:
        runs = np.asarray(task, dtype=np.float64)
        drawn.append(runs[random.integers(len(runs), size=(resamples, len(runs)))])
    return np.concatenate(drawn, axis=1)


def interval(values: ArrayLike, confidence: float = CONFIDENCE) -> tuple[Array, Array]:
    """Return the ends of the percentile interval of a statistic's bootstrap samples (B, ...)."""
    tail = (1 - confidence) / 2
    low, high = np.quantile(values, (tail, 1 - tail), axis=0)
    return low, high


def normalizer(hypervolumes: Iterable[ArrayLike], reference: float | None) -> float:
    """Return the hypervolume of a task that counts as a score of 1.

    Args:
        hypervolumes: per method, those of its runs.
        reference: hypervolume of the reference front (None: the best median over runs).
    """
    if reference is not None:
        return reference
    return max(float(np.median(of_one)) for of_one in hypervolumes)


def scaled_igd_plus(points: ArrayLike, reference_front: ArrayLike) -> float:
    """Compute IGD+ after dividing every objective by the range of the reference front.

    Without a range, as on a front of one point, an objective keeps its scale.

    Args:
        points: (n, m), maximized.
        reference_front: (k, m).
    """
    reference = np.asarray(reference_front, dtype=np.float64)
    spans = np.ptp(reference, axis=0)
    spans = np.where(spans > 0, spans, 1.0)
    return pareto.igd_plus(np.asarray(points) / spans, reference / spans)
