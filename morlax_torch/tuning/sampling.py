"""Draws the options of a trial."""

import random
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from ..envs.devices import seed_of
from .plan import Plan
from .storage import optuna

ATTEMPTS = 1000  # draws of values that fit together
GUIDED = 20  # of them; the others are random
KNOWN = 20  # finished trials, from which on TPE draws every second trial
CHANGED = 0.1  # share of the options that a trial changes, beside one


class Sampler(optuna.samplers.BaseSampler):
    """Draws values that make a valid config; trial 0 is the base config.

    Most random combinations of many options do not train, and a search has few trials. So trials
    change one or a few options of the best trial so far; later, TPE draws every second trial.

    Each trial has a seed of its own, so that processes with the same command draw different ones.
    `base` is the draw of the base config, empty if it lies outside the space; `valid` says whether
    a draw makes a config.
    """

    def __init__(self, plan: Plan, base: dict[str, Any], valid: Callable[[dict[str, Any]], bool]):
        self._distributions, self._seed = plan.space.distributions, plan.base.seed
        self._base, self._valid = base, valid

    def infer_relative_search_space(
        self, study: optuna.Study, trial: optuna.trial.FrozenTrial
    ) -> dict[str, Any]:
        return {name: each for name, each in self._distributions.items() if not each.single()}

    def sample_relative(
        self, study: optuna.Study, trial: optuna.trial.FrozenTrial, search_space: dict[str, Any]
    ) -> dict[str, Any]:
        if trial.number == 0:
            return self._base
        found: dict[str, Any] = {}
        for found in islice(self._draws(study, trial, search_space), ATTEMPTS):
            if self._valid(found):
                break
        return found

    def _draws(
        self, study: optuna.Study, trial: optuna.trial.FrozenTrial, space: dict[str, Any]
    ) -> Iterator[dict[str, Any]]:
        """Yield draws that earlier trials guide, then random ones."""
        seed = seed_of(self._seed, trial.number) % 2**32
        model = optuna.samplers.TPESampler(multivariate=True, constant_liar=True, seed=seed)
        even, chance = optuna.samplers.RandomSampler(seed), random.Random(seed)
        finished = [each for each in study.get_trials(deepcopy=False) if each.state.is_finished()]
        by_model = len(finished) >= KNOWN and trial.number % 2
        best = [each.params for each in study.best_trials] or [self._base]
        origin = {name: value for name, value in chance.choice(best).items() if name in space}

        def redraw(name: str) -> Any:
            return even.sample_independent(study, trial, name, space[name])

        for _ in range(GUIDED):
            if by_model:
                found = model.sample_relative(study, trial, space)
            else:
                found = _neighbor(origin, redraw, chance)
            if found and found != origin:
                yield found
        while True:
            yield {name: redraw(name) for name in space}

    def sample_independent(self, study, trial, param_name, param_distribution) -> Any:
        raise NotImplementedError("all options are drawn together")


def _neighbor(
    origin: dict[str, Any], redraw: Callable[[str], Any], chance: random.Random
) -> dict[str, Any]:
    """Redraw one value, and each of the others with a small probability."""
    one = chance.choice(list(origin)) if origin else None
    return {
        name: redraw(name) if name == one or chance.random() < CHANGED else value
        for name, value in origin.items()
    }
