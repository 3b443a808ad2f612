"""Asynchronous successive halving over training time."""

from .library import optuna

EVALUATIONS = 9  # per trial
REDUCTION = 3  # a third of the trials goes on at each rung: after 1/9 and 1/3 of the time


def make_pruner(seconds: float) -> optuna.pruners.BasePruner:
    """Return a pruner whose steps are those of `step`."""
    first = max(1, step(seconds / EVALUATIONS))
    return optuna.pruners.SuccessiveHalvingPruner(first, REDUCTION)


def step(train_seconds: float) -> int:
    """Return training time in milliseconds."""
    return int(1000 * train_seconds)
