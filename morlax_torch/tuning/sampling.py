"""Draws the options of a trial."""

from collections.abc import Callable
from typing import Any

from ..envs.random import seed_of
from .library import optuna

ATTEMPTS = 1000  # draws of values that fit together
BY_TPE = 20  # of them; the others are random


class Sampler(optuna.samplers.BaseSampler):
    """TPE among the values that make a valid config; trial 0 is the base config.

    Each trial has a seed of its own, so that processes with the same command draw different ones.

    Args:
        distributions: of Optuna, by option.
        base: draws of the base config; empty if it lies outside.
        seed: random seed of the study.
        valid: whether draws make a config.
    """

    def __init__(
        self,
        distributions: dict[str, Any],
        base: dict[str, Any],
        seed: int,
        valid: Callable[[dict[str, Any]], bool],
    ):
        self._distributions, self._base, self._seed = distributions, base, seed
        self._valid = valid

    def infer_relative_search_space(
        self, study: optuna.Study, trial: optuna.trial.FrozenTrial
    ) -> dict[str, Any]:
        return {name: each for name, each in self._distributions.items() if not each.single()}

    def sample_relative(
        self, study: optuna.Study, trial: optuna.trial.FrozenTrial, search_space: dict[str, Any]
    ) -> dict[str, Any]:
        if trial.number == 0:
            return self._base
        seed = seed_of(self._seed, trial.number) % 2**32
        model = optuna.samplers.TPESampler(multivariate=True, constant_liar=True, seed=seed)
        even = optuna.samplers.RandomSampler(seed)
        found: dict[str, Any] = {}
        for attempt in range(ATTEMPTS):
            # TPE repeats its favorite values, even where they do not fit together
            found = model.sample_relative(study, trial, search_space) if attempt < BY_TPE else {}
            found = found or {
                name: even.sample_independent(study, trial, name, each)
                for name, each in search_space.items()
            }
            if self._valid(found):
                break
        return found

    def sample_independent(
        self,
        study: optuna.Study,
        trial: optuna.trial.FrozenTrial,
        param_name: str,
        param_distribution: Any,
    ) -> Any:
        raise NotImplementedError("all options are drawn together")
