"""The reward terms of worlds that other programs train in, grouped into objectives."""

from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from functools import partial
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from ..envs.errors import MorlaxError, unknown, user_code

Weights = Mapping[str, float]  # factors by a term's name, or by a pattern such as track_*
WATCHED = 1e-9  # weight of a term that the host does not pay, so that it computes the term
TOLERANCE = 1e-3  # of the sum of terms, relative to the sum of their sizes
CHECKED = 100  # first steps with a check; a host that clips rewards may clip none in the first one
SIGNS = {"rewards": 1, "costs": -1}  # default objectives, of the terms with such weights
APART = "termination"  # a term that legged_gym keeps out of its list of functions


class ManagerTerms:
    """The terms of a reward manager, as in mjlab and Isaac Lab.

    `weights` are the host's, of every term by name; 0.0: it does not pay the term.
    """

    def __init__(self, env: Any):
        self._manager = env.reward_manager
        self.weights = self.paid()
        scaled = getattr(env.cfg, "scale_rewards_by_dt", True)
        self._time_step = env.step_dt if scaled else 1.0

    def paid(self) -> dict[str, float]:
        """Return the weights of now, which a curriculum may have changed."""
        config = self._manager.get_term_cfg
        weights = {name: float(config(name).weight) for name in self._manager.active_terms}
        return {name: weight * (weight != WATCHED) for name, weight in weights.items()}

    def watch(self, name: str) -> float:
        """Let the host compute a term that it does not pay; returns what to multiply it by."""
        self._manager.get_term_cfg(name).weight = WATCHED
        return 1 / WATCHED

    def read(self) -> Tensor:
        """Return the terms (N, t) of the last step, as paid, in the order of `weights`."""
        return self._manager._step_reward * self._time_step


class FunctionTerms:
    """The terms of `env.reward_functions`, as in Genesis (by name) and legged_gym (a list).

    The functions are wrapped, and keep what they returned last.
    """

    def __init__(self, env: Any):
        self._env, functions = env, env.reward_functions
        self.weights = self.paid()
        self._paid: dict[str, Tensor] = {}
        keys = [*(functions if isinstance(functions, dict) else range(len(functions)))]
        names = [*self.weights]
        for key, name in zip(keys, names, strict=False):
            functions[key] = partial(self._call, name, functions[key])
        if names[len(keys) :] == [APART]:  # not among the functions
            env._reward_termination = partial(self._call, APART, env._reward_termination)

    def paid(self) -> dict[str, float]:
        functions, scales = self._env.reward_functions, self._env.reward_scales
        names = functions if isinstance(functions, dict) else self._env.reward_names
        apart = [APART] if scales.get(APART) else []
        return {name: float(scales[name]) for name in (*names, *apart)}

    def _call(self, name: str, function: Callable[[], Tensor]) -> Tensor:
        value = function()
        self._paid[name] = value * self._env.reward_scales[name]
        return value

    def watch(self, name: str) -> float:
        raise MorlaxError(f"the reward term {name} has no scale: give it one in the environment.")

    def read(self) -> Tensor:
        try:
            return torch.stack([self._paid.pop(name) for name in self.weights], -1)
        except KeyError as name:
            raise MorlaxError(
                f"the environment calls another reward function {name} than it listed at first: "
                "name a function that reads its terms, terms: MODULE:FUNCTION."
            ) from None


class CalledTerms:
    """The terms that a user's "MODULE:FUNCTION" reads from the worlds: name -> (N,)."""

    def __init__(self, env: Any, name: str, worlds: int):
        module, _, function = name.partition(":")
        if not (module and function):
            raise MorlaxError(f"terms must be MODULE:FUNCTION, such as mine:terms, not {name!r}.")
        self._worlds, self._failure = worlds, f"the reward terms {name} cannot be read"
        with user_code(self._failure):
            self._read = partial(getattr(import_module(module), function), env)
            self._values = dict(self._read())
        self.weights = self.paid()

    def paid(self) -> dict[str, float]:
        return dict.fromkeys(self._values, 1.0)

    def watch(self, name: str) -> float:
        return 1.0

    def read(self) -> Tensor:
        with user_code(self._failure):
            self._values = values = self._read()
            return torch.stack([values[name].reshape(self._worlds) for name in self.weights], -1)


Terms = ManagerTerms | FunctionTerms | CalledTerms


def terms_of(env: Any, reader: str | None = None) -> Terms:
    """Return the reward terms of an environment; `reader` names a function for unknown ones."""
    base = getattr(env, "unwrapped", env)
    if reader:
        return CalledTerms(base, reader, env.num_envs)
    if getattr(base, "reward_manager", None):
        return ManagerTerms(base)
    if getattr(base, "reward_functions", None):
        return FunctionTerms(base)
    raise MorlaxError(
        f"{type(base).__name__} has no reward_manager and no reward_functions: name a function "
        "that reads its reward terms, terms: MODULE:FUNCTION."
    )


class ObjectiveRewards:
    """Turns the reward terms of a step into rewards per objective.

    Args:
        terms: of the worlds.
        objectives: per objective, the factor of each of its terms. None: all terms with a positive
            weight, `rewards`, against all others, `costs`, or each term if weights are unknown.
        guide: factors of the terms that every trade-off learns from. None: with given objectives,
            the terms that no objective has; else the whole reward.
    """

    def __init__(
        self,
        terms: Terms,
        objectives: Mapping[str, Weights] | None = None,
        guide: Weights | None = None,
    ):
        self._terms, weights = terms, terms.weights
        if objectives is None:
            guide = {"*": 1.0} if guide is None else guide
            objectives = {
                name: {term: 1.0 for term, weight in weights.items() if weight * sign > 0}
                for name, sign in SIGNS.items()
            }
            if isinstance(terms, CalledTerms):
                objectives = {name: {name: 1.0} for name in weights}
            elif not all(objectives.values()):
                raise MorlaxError(
                    "all reward terms have the same sign, so nothing is to trade off: name the "
                    "objectives."
                )
        self.objectives = {name: self._expanded(group) for name, group in objectives.items()}
        if guide is None:
            used = {term for group in self.objectives.values() for term in group}
            guide = {name: 1.0 for name, weight in weights.items() if weight and name not in used}
        self.guide = self._expanded(guide)
        rows = [*self.objectives.values(), self.guide]
        unpaid = [name for name in weights if not weights[name] and any(name in x for x in rows)]
        factors = {name: terms.watch(name) for name in unpaid}
        self._matrix = torch.tensor(
            [[row.get(name, 0.0) * factors.get(name, 1.0) for row in rows] for name in weights],
            dtype=torch.float32,
        )  # (t, m + 1)
        self._paid = torch.tensor([float(weight != 0) for weight in weights.values()])
        # terms that a function reads need not be the reward's
        self._unchecked = 0 if isinstance(terms, CalledTerms) else CHECKED

    def _expanded(self, group: Weights) -> dict[str, float]:
        """Return factors by names of terms; patterns stand for terms that the host pays."""
        factors: dict[str, float] = {}
        weights = self._terms.weights
        for pattern, factor in group.items():
            names = [name for name in weights if weights[name] and fnmatchcase(name, pattern)]
            names = [pattern] if pattern in weights else names
            if not names:
                raise unknown("reward term", pattern, weights)
            factors |= dict.fromkeys(names, float(factor))
        return {name: factor for name, factor in factors.items() if factor}

    def __call__(self, reward: Tensor) -> tuple[Tensor, Tensor]:
        """Return the last step's rewards per objective (N, m), and the guide (N, 1).

        Raises:
            MorlaxError: the terms cannot be read, or do not add up to the host's `reward` (N,) in
                the first steps.
        """
        terms = self._terms.read().to(reward.device, torch.float32)
        for name, weight in self._terms.paid().items():
            if weight and not self._terms.weights.get(name):
                raise MorlaxError(
                    f"the reward term {name} had no weight when training began, and now has one: "
                    "give it a small weight from the start."
                )
        self._matrix, self._paid = self._matrix.to(terms), self._paid.to(terms)
        if self._unchecked:
            self._unchecked -= 1
            paid = terms * self._paid
            difference = float((paid.sum(-1) - reward).abs().max())
            if not difference <= TOLERANCE * (TOLERANCE + float(paid.abs().sum(-1).max())):
                raise MorlaxError(
                    f"the reward terms add up to another reward than the environment's (by up to "
                    f"{difference:.2g}): turn its clipping off, such as legged_gym's "
                    "only_positive_rewards, or name a function that reads them, terms: "
                    "MODULE:FUNCTION."
                )
        rewards = terms @ self._matrix
        return rewards[:, :-1], rewards[:, -1:]
