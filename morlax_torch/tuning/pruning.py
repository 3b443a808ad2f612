"""Asynchronous successive halving over training time."""

from .library import optuna

FIRST, REDUCTION = 1 / 9, 3  # a third of the trials goes on after 1/9 and 1/3 of the time
EVALUATED = (FIRST, REDUCTION * FIRST, 2 / 3)  # shares of the time, beside its start and its end


def make_pruner(seconds: float) -> optuna.pruners.BasePruner:
    """Return a pruner whose steps are those of `step`."""
    first = max(1, step(FIRST * seconds))
    return optuna.pruners.SuccessiveHalvingPruner(first, REDUCTION)


def step(train_seconds: float) -> int:
    """Return training time in milliseconds."""
    return int(1000 * train_seconds)
