"""Generations of NSGA-II, by Optuna."""

from collections.abc import Mapping

import numpy as np

from ..envs.errors import MorlaxError, installation

try:
    import optuna
    from optuna.distributions import FloatDistribution
    from optuna.study import StudyDirection
    from optuna.trial import TrialState as TrialState
except ImportError as error:
    needed = f"this search needs {error.name}, which is not installed: {installation('optuna')}."
    raise MorlaxError(needed) from None

optuna.logging.set_verbosity(optuna.logging.ERROR)


def evolution(
    ranges: Mapping[str, FloatDistribution],
    starts: np.ndarray,
    objectives: int,
    population: int,
    seed: int,
) -> optuna.Study:
    """Return a study of NSGA-II, whose first generation has the first of the starts (k, d)."""
    limited = seed % 2**32  # as numpy's RandomState takes it
    sampler = optuna.samplers.NSGAIISampler(population_size=population, seed=limited)
    directions = [StudyDirection.MAXIMIZE] * objectives
    study = optuna.create_study(directions=directions, sampler=sampler)
    for start in starts[:population].tolist():
        study.enqueue_trial(dict(zip(ranges, start, strict=True)))
    return study


def generation(
    study: optuna.Study, ranges: Mapping[str, FloatDistribution], population: int
) -> tuple[list[optuna.Trial], np.ndarray]:
    """Return the next trials of an evolution, and their values (population, d)."""
    trials = [study.ask({**ranges}) for _ in range(population)]
    for trial in trials:
        _ = trial.relative_params  # else Optuna 5 leaves queued trials out of the population
    return trials, np.array([[trial.params[name] for name in ranges] for trial in trials])
