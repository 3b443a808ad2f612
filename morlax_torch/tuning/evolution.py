"""NSGA-II, by Optuna."""

from collections.abc import Callable, Mapping

import numpy as np

from ..envs.errors import require

require("Optuna", "optuna", "5.0", "optuna")

import optuna
from optuna.distributions import FloatDistribution
from optuna.study import StudyDirection
from optuna.trial import TrialState

optuna.logging.set_verbosity(optuna.logging.ERROR)


def evolve(
    ranges: Mapping[str, tuple[float, float]],
    starts: np.ndarray,
    objectives: int,
    population: int,
    generations: int,
    seed: int,
    score: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Run NSGA-II on d numbers within ranges; the first generation has the first of starts (k, d).

    `score` maps a generation (population, d) to scores (population, objectives) to maximize; those
    that are not finite have failed.
    """
    limited = seed % 2**32  # as numpy's RandomState takes it
    sampler = optuna.samplers.NSGAIISampler(population_size=population, seed=limited)
    space = {name: FloatDistribution(*limits) for name, limits in ranges.items()}
    directions = [StudyDirection.MAXIMIZE] * objectives
    study = optuna.create_study(directions=directions, sampler=sampler)
    for start in starts[:population].tolist():
        study.enqueue_trial(dict(zip(ranges, start, strict=True)))
    for _ in range(generations):
        trials = [study.ask({**space}) for _ in range(population)]
        for trial in trials:
            _ = trial.relative_params  # else Optuna 5 leaves queued trials out of the population
        drawn = np.array([[trial.params[name] for name in ranges] for trial in trials])
        for trial, scores in zip(trials, score(drawn), strict=True):
            if np.isfinite(scores).all():
                study.tell(trial, scores.tolist())
            else:
                study.tell(trial, state=TrialState.FAIL)
