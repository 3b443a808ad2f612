"""The search space: options of a config, with Optuna's distributions of their values."""

import json
import math
import warnings
from collections.abc import Mapping
from typing import Any

from ..configuration.config import DRAFT, Config, flat, load_config
from ..configuration.files import merged, nested
from ..envs import MorlaxError
from ..envs.errors import installation, shortened

try:
    import optuna
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
    from optuna.trial import FrozenTrial as Trial
    from optuna.trial import TrialState as State
except ImportError as error:
    raise MorlaxError(
        f"tuning needs {error.name}, which is not installed: {installation('tune')}."
    ) from None

optuna.logging.set_verbosity(optuna.logging.ERROR)

__all__ = ["Space", "State", "Trial", "optuna"]

Distribution = CategoricalDistribution | FloatDistribution | IntDistribution
SHARED = "all trials share it, so that they can be compared: leave it out"
ATTEMPTS = 1000  # draws, of which one must make a valid config
FIXED = (  # sections and options that all trials share
    *("env", "algorithm", "seed", "device", "backend", "deterministic", "evaluation"),
    *("max_env_steps", "max_seconds", "task.objectives", "task.shared", "task.reference_point"),
)


class Space:
    """Options by dotted name, with the values that trials may give them.

    Args:
        values: by option, a list of values, the fields of a range, or factors of the base value.
        base: the config that trials change.
        source: what error messages call the space.

    Raises:
        MorlaxError: an option is unknown, or must be equal in all trials, a value of it is not
            valid, or values do not fit together.
    """

    def __init__(self, values: Mapping[str, Any], base: Config, source: str):
        if not values:
            raise MorlaxError(f"{source} is empty: name options, such as ppo.epochs: [3, 4].")
        self.base, self.distributions = base, dict[str, Distribution]()
        for name, choices in values.items():
            try:
                self._add(str(name), choices)
            except (MorlaxError, TypeError, ValueError) as error:
                raise MorlaxError(f"{source}: {name}: {str(error).rstrip('.')}.") from None
        rehearsal, reason = optuna.create_study(sampler=optuna.samplers.RandomSampler(0)), None
        for _ in range(ATTEMPTS):
            try:
                self.config(rehearsal.ask({**self.distributions}).params)
                return
            except MorlaxError as error:
                reason = error
        raise MorlaxError(
            f"{ATTEMPTS} draws from {source} do not fit together, the last one because {reason}"
        )

    def _add(self, name: str, choices: Any) -> None:
        """Add an option, or raise ValueError or MorlaxError if it cannot have these values."""
        options = flat(self.base.model_dump(mode="json"))
        if any(f"{name}.".startswith(f"{fixed}.") for fixed in FIXED):
            raise ValueError(SHARED)
        inside = [option for option in options if option.startswith(f"{name}.")]
        if inside:
            raise ValueError(f"it is a section: name its options, such as {inside[0]}")
        self.distributions[name] = each = _distribution(choices, options.get(name))
        if isinstance(each, CategoricalDistribution):
            examples = [*each.choices]
        else:  # a value between shows whether an option must be whole
            examples = [each.low, each.high, type(each.low)(0.382 * each.low + 0.618 * each.high)]
        for example in examples:
            config = self.config({name: example}, DRAFT)
            if config.task.for_evaluation() != self.base.task.for_evaluation():
                raise ValueError(SHARED)

    def config(self, draw: Mapping[str, Any], context: Any = None) -> Config:
        """Return the config of a draw, or raise MorlaxError if values do not fit together."""
        values = self.base.model_dump(mode="json")
        for name, drawn in draw.items():
            value = drawn
            if isinstance(self.distributions[name], FloatDistribution):
                value = float(f"{drawn:.6g}")  # so that files show 0.15, not 0.15000000000000002
            elif isinstance(drawn, str) and drawn.startswith("["):
                value = json.loads(drawn)
            values = merged(values, nested(name, value))
        return load_config(values, context)

    def base_draw(self) -> dict[str, Any]:
        """Return the draw that gives the base config; empty if it lies outside the space."""
        options = flat(self.base.model_dump(mode="json"))
        draw = {name: _label(options.get(name)) for name in self.distributions}
        try:
            optuna.trial.create_trial(params=draw, distributions={**self.distributions}, value=0.0)
        except ValueError:
            return {}
        return draw

    def suggest(self, trial: optuna.Trial) -> None:
        """Draw all options of a trial."""
        for name, each in self.distributions.items():
            if isinstance(each, CategoricalDistribution):
                trial.suggest_categorical(name, each.choices)
            elif isinstance(each, IntDistribution):
                trial.suggest_int(name, each.low, each.high, step=each.step, log=each.log)
            else:
                trial.suggest_float(name, each.low, each.high, step=each.step, log=each.log)


def _distribution(choices: Any, base: Any) -> Distribution:
    if isinstance(choices, dict) and "times" in choices:
        return CategoricalDistribution(_multiples(choices["times"], base))
    if isinstance(choices, list):
        return CategoricalDistribution([_label(choice) for choice in choices])
    if not isinstance(choices, dict):
        raise ValueError(f"use a list of values or {{low: ..., high: ...}}, not {choices!r}")
    values = {key: _label(value) for key, value in choices.items()}
    numbers = [value for key, value in values.items() if key != "log"]
    if not all(isinstance(number, int | float) for number in numbers):
        raise ValueError(f"{numbers} are not all numbers")
    whole = all(isinstance(number, int) for number in numbers)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Optuna moves `high` to the last step, and says so
        return IntDistribution(**values) if whole else FloatDistribution(**values)


def _multiples(factors: Any, base: Any) -> list[float]:
    numbers: list[Any] = factors if isinstance(factors, list) else [None]
    if isinstance(base, bool) or not isinstance(base, int | float):
        raise ValueError(f"{shortened(base)} in the base config has no multiples")
    if not all(isinstance(x, int | float) and 0 < x < math.inf for x in numbers):
        raise ValueError("use a list of positive factors, such as {times: [0.5, 1, 2]}")
    values = [max(1, round(base * x)) if isinstance(base, int) else base * x for x in numbers]
    return list(dict.fromkeys(values))


def _label(value: Any) -> Any:
    """Return a value in a type that Optuna's storages keep; YAML takes 1e-4 as text."""
    if isinstance(value, list):
        return json.dumps(value)
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value
