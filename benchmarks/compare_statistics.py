"""Statistics over training runs, in NumPy, as in rliable (Agarwal et al., 2021).

Scores come as one array per task, with one score per run. Higher is better.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import trim_mean

Array = NDArray[np.float64]

RESAMPLES = 10_000  # of the bootstrap
CONFIDENCE = 0.95


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


def interquartile_mean(scores: ArrayLike) -> Array:
    """Return the mean of scores (..., n) without the lowest and the highest quarter."""
    return trim_mean(scores, 0.25, axis=-1)


def interval(
    statistic: Callable[[Array], Array], tasks: Sequence[ArrayLike], seed: int = 0
) -> tuple[float, float]:
    """Return the bootstrap interval of a statistic of runs, resampled within each task.

    Args:
        statistic: of the scores (RESAMPLES, n) of n runs, those of a task side by side.
        tasks: per task, the scores of its runs.
        seed: random seed.
    """
    random = np.random.default_rng(seed)
    drawn = []
    for task in tasks:
        runs = np.asarray(task, dtype=np.float64)
        drawn.append(runs[random.integers(len(runs), size=(RESAMPLES, len(runs)))])
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(statistic(np.concatenate(drawn, 1)), (tail, 1 - tail))
    return float(low), float(high)


def median(scores: ArrayLike) -> Array:
    return np.median(scores, axis=-1)


def mean(scores: ArrayLike) -> Array:
    return np.mean(scores, axis=-1)
