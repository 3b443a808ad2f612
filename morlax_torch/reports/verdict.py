"""Say in a sentence or two how good a front is, and what to do next."""

from collections.abc import Mapping

import numpy as np

from ..evaluation.front import Front
from ..evaluation.pareto import conflicting_pairs
from ..runs.progress import History
from .comparison import Evaluated

LONGER = "train longer (--max-env-steps or --max-seconds)"
MOST_FALLS = 0.5  # share of failed episodes above which nothing else matters
SOME_FALLS = 0.05  # share of failed episodes that is worth a remark
FEW = 0.05  # share of policies below which the front is poor
NARROW = 0.05  # of an objective: range over the front, as a share of its distance to the reference
RISING = 0.03  # gain of hypervolume in the last quarter of training, as a share
BELOW = 0.05  # of a suggested reference point: distance to the worst return, as a share
FEWEST = 4  # evaluations that show whether the hypervolume still rises


def verdict_of(runs: Mapping[str, Evaluated]) -> str:
    """Return the verdict on a run, or of several runs on the one with the highest hypervolume."""
    name, run = max(runs.items(), key=lambda item: item[1].front.hypervolume)
    which = f"Of {len(runs)} runs, {name} has the highest hypervolume. " if len(runs) > 1 else ""
    return which + verdict(run.front, run.history)


def verdict(front: Front, history: History | None) -> str:
    """Return what the data say about a front, the most serious finding first."""
    rising = None if history is None else _rising(history)
    problem, nothing = _problem(front), unreached(front)
    if nothing is not None:
        sentences = [nothing] if problem else [nothing, _gain(front)]
    elif problem is not None:
        sentences = [problem, rising]
    else:
        sentences = [_gain(front), rising and f"{rising}: {LONGER}"]
    return " ".join(f"{sentence}." for sentence in sentences if sentence)


def _problem(front: Front) -> str | None:
    """Return what is wrong with a front, with a remedy; None if nothing is."""
    best, K = int(front.non_dominated.sum()), len(front.tradeoffs)
    remedy = f"{LONGER}, or check that the objectives conflict"
    if best == 0:
        return "No policy has finite returns: check the rewards of the task"
    if (rate := float(front.falls.mean())) > MOST_FALLS:
        fail = "Every episode fails" if rate == 1 else f"{100 * rate:.3g} % of the episodes fail"
        return f"{fail}: {LONGER}{_failing_pays(front)}"
    if best < K and best <= max(len(front.objectives), FEW * K):
        are = "policies is" if best == 1 else "policies are"
        return f"Only {best} of {K} {are} non-dominated: {remedy}"
    returns = front.returns[front.non_dominated]
    narrow = np.ptp(returns, axis=0) <= NARROW * np.abs(returns.max(0) - front.reference_point)
    if narrow.any():
        names = " and ".join(np.array(front.shown)[narrow])
        return f"The returns of the front hardly differ in {names}: {remedy}"
    return None


def unreached(front: Front) -> str | None:
    """Say that no policy exceeds the reference point, and which one would be right, if so."""
    returns = front.returns[np.isfinite(front.returns).all(1)]
    if not len(returns) or (returns > front.reference_point).all(1).any():
        return None
    point = zip(front.shown, map(_plain, front.reference_point), strict=True)
    text = (
        f"No policy exceeds the reference point ({', '.join(map(' '.join, point))}) in every "
        "objective, so the hypervolume is 0 and shows no progress"
    )
    if front.protocol == "discounted":  # whose point is the same for all tasks
        return f"{text}: use --evaluation.protocol latched{_failing_pays(front)}"
    worst = returns.min(0)
    size = np.maximum(np.abs(worst), np.ptp(returns, axis=0))
    lower = [float(f"{x:.3g}") for x in worst - BELOW * np.where(size > 0, size, 1.0)]
    right = np.where(worst > front.reference_point, front.reference_point, lower)
    return (
        f"{text}: train with --task.reference-point {' '.join(map(_plain, right))}, slightly below "
        f"the worst returns{_failing_pays(front)}"
    )


def _failing_pays(front: Front) -> str:
    """Add a sentence if returns are negative and episodes can end early."""
    finite = front.returns[np.isfinite(front.returns).all(1)]
    costs = [name for name, most in zip(front.shown, finite.max(0), strict=True) if most < 0]
    if not costs or not front.falls.any():
        return ""
    return (
        f". All returns of {' and '.join(costs)} are negative and some episodes fail, so failing "
        "early pays: reward every step, as the term alive of some tasks does"
    )


def _plain(value: float) -> str:
    """Return a number without an exponent, which options could not read."""
    return np.format_float_positional(value, precision=6, fractional=False, trim="-")


def _gain(front: Front) -> str:
    """Say what the front offers, between the two objectives that conflict most."""
    returns, names = front.returns[front.non_dominated], front.shown
    ((one, other),) = conflicting_pairs(returns)
    changes = []
    for k in (one, other):
        start, end = returns[returns[:, one].argmax(), k], returns[returns[:, other].argmax(), k]
        moves = "rises" if end > start else "falls"
        # a share means something only of positive returns
        share = f" by {100 * abs(end / start - 1):.0f} %" if start > 0 and end > 0 else ""
        changes.append(f"{names[k]} {moves}{share} ({start:,.4g} to {end:,.4g})")
    offer = (
        f"{len(returns)} of {len(front.tradeoffs)} policies are non-dominated; from the best "
        f"policy of {names[one]} to that of {names[other]}, {' and '.join(changes)}"
    )
    rate = float(front.falls.mean())
    return f"{offer}; {100 * rate:.3g} % of the episodes fail" if rate > SOME_FALLS else offer


def _rising(history: History) -> str | None:
    """Say by how much the best hypervolume so far rose at the end of training, if it did."""
    steps, best = history.env_steps, np.maximum.accumulate(history.hypervolume)
    if len(steps) < FEWEST:
        return None
    index = np.flatnonzero(steps <= steps[0] + 0.75 * (steps[-1] - steps[0]))[-1]
    if best[-1] <= best[index] * (1 + RISING):
        return None
    share = (steps[-1] - steps[index]) / (steps[-1] - steps[0])
    gain = f"by {100 * (best[-1] / best[index] - 1):.0f} %" if best[index] > 0 else "from 0"
    end = "quarter" if share < 0.3 else f"{100 * share:.0f} %"
    return f"The hypervolume still rose {gain} over the last {end} of training"
