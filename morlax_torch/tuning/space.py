"""The search space: options of a config, and the values that trials may give them."""

import json
import math
from collections.abc import Mapping
from decimal import Decimal
from typing import Any, NamedTuple, Self

from pydantic import ValidationError

from ..configuration.config import Config, config_class, flat, load_config
from ..configuration.files import merged, nested
from ..envs import MorlaxError
from ..envs.errors import explained, shortened, unknown
from .storage import optuna

Distribution = optuna.distributions.BaseDistribution

DIGITS = 6  # of drawn numbers, so that files show 0.15 instead of 0.15000000000000002
RANGE = ("low", "high", "log", "step")
FIXED = (  # sections and options that all trials share
    *("env", "algorithm", "seed", "device", "backend", "deterministic", "evaluation"),
    *("max_env_steps", "max_seconds", "task.objectives", "task.shared", "task.reference_point"),
)


class OneOf(NamedTuple):
    values: tuple[Any, ...]

    @property
    def distribution(self) -> Distribution:
        labels = [_label(value) for value in self.values]
        return optuna.distributions.CategoricalDistribution(labels)

    @property
    def examples(self) -> tuple[Any, ...]:
        """Values of every type that trials may get."""
        return self.values

    def value(self, drawn: Any) -> Any:
        return next(value for value in self.values if _label(value) == drawn)

    def drawn(self, value: Any) -> Any:
        """Return the draw that gives a value; raises ValueError if there is none."""
        return _label(self.values[self.values.index(value)])


class Range(NamedTuple):
    low: float
    high: float
    log: bool = False
    step: float | None = None

    @property
    def distribution(self) -> Distribution:
        if self._whole:
            step = 1 if self.step is None else int(self.step)
            low, high = int(self.low), int(self.high)
            return optuna.distributions.IntDistribution(low, high, self.log, step)
        return optuna.distributions.FloatDistribution(self.low, self.high, self.log, self.step)

    @property
    def examples(self) -> tuple[Any, ...]:
        between = () if self._whole else (self.low + 0.618 * (self.high - self.low),)
        return (self.low, self.high, *between)

    def value(self, drawn: Any) -> Any:
        return drawn if self._whole else float(f"{drawn:.{DIGITS}g}")

    def drawn(self, value: Any) -> Any:
        """Return the draw that gives a value; raises ValueError if there is none."""
        if not isinstance(value, int | float) or not self.low <= value <= self.high:
            raise ValueError
        step = self.step or (1 if self._whole else None)
        if step and (Decimal(str(value)) - Decimal(str(self.low))) % Decimal(str(step)):
            raise ValueError
        return value

    @property
    def _whole(self) -> bool:
        return all(isinstance(x, int) for x in (self.low, self.high, self.step or 1))


class Space(NamedTuple):
    """Options by dotted name, with the values that trials may give them."""

    parameters: Mapping[str, OneOf | Range]

    @classmethod
    def of(cls, values: Mapping[str, Any], base: Config, source: str) -> Self:
        """Check a space of plain values: by option, a list of values or the fields of a range.

        Raises:
            MorlaxError: an option is unknown, or must be equal in all trials, or a range or value
                of it is not valid.
        """
        if not values:
            raise MorlaxError(f"{source} is empty: name options, such as ppo.epochs: [3, 4].")
        parameters, options = {}, flat(base.model_dump(mode="json"))
        for name, given in values.items():
            name = str(name)
            if any(f"{name}.".startswith(f"{fixed}.") for fixed in FIXED):
                raise _uneven(source, name)
            inside = [option for option in options if option.startswith(f"{name}.")]
            if inside:
                raise MorlaxError(
                    f"{source}: {name} is a section: name its options, such as {inside[0]}."
                )
            try:
                parameters[name] = _parameter(given, options.get(name))
            except ValueError as error:
                raise MorlaxError(f"{source}: {name} {error}.") from None
            for value in parameters[name].examples:
                _check(name, value, base, source)
        return cls(parameters)

    @property
    def distributions(self) -> dict[str, Distribution]:
        return {name: each.distribution for name, each in self.parameters.items()}

    def options(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of each option for a draw of Optuna."""
        return {name: self.parameters[name].value(value) for name, value in drawn.items()}

    def config(self, base: Config, drawn: Mapping[str, Any]) -> Config:
        """Return the config of a trial, or raise MorlaxError if values do not fit together."""
        values = base.model_dump(mode="json")
        for name, value in self.options(drawn).items():
            values = merged(values, nested(name, value))
        return load_config(values)

    def drawn(self, config: Config) -> dict[str, Any]:
        """Return the draw that gives a config; empty if the config lies outside the space."""
        values = flat(config.model_dump(mode="json"))
        try:
            return {name: each.drawn(values[name]) for name, each in self.parameters.items()}
        except ValueError:
            return {}


def _label(value: Any) -> Any:
    """Return a value in a type that Optuna's storages keep."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _number(value: Any) -> Any:
    """Return a number for text such as 1e-4, which YAML takes as a number only with a point."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _parameter(given: Any, base: Any) -> OneOf | Range:
    """Parse the values of one option; raises ValueError with the rest of a sentence."""
    if isinstance(given, list):
        return _choice([_number(value) for value in given])
    if isinstance(given, dict) and "times" in given:
        return _multiples(given, base)
    if not isinstance(given, dict) or not {"low", "high"} <= set(given):
        raise ValueError(
            f"needs a list of values or {{low: ..., high: ...}}, not {shortened(given)}"
        )
    for key in given:
        if key not in RANGE:
            raise ValueError(f"has an {str(unknown('key', str(key), RANGE)).rstrip('.')}")
    if not isinstance(given.get("log", False), bool):
        raise ValueError(f"has log {shortened(given['log'])}: use true or false")
    numbers = {key: _number(given[key]) for key in ("low", "high", "step") if key in given}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"has {key} {shortened(value)}, which is not a number")
        if not abs(value) < math.inf:
            raise ValueError(f"has {key} {value}, which is not finite")
    return _range(**numbers, log=given.get("log", False))


def _choice(values: list[Any]) -> OneOf:
    if not values:
        raise ValueError("has an empty list: name at least one value")
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"lists {shortened(value)} twice")
    return OneOf(tuple(values))


def _multiples(given: dict, base: Any) -> OneOf:
    factors = [_number(x) for x in given["times"]] if isinstance(given["times"], list) else []
    numbers = all(isinstance(x, int | float) and 0 < x < math.inf for x in factors)
    if len(given) > 1 or not factors or not numbers:
        raise ValueError("needs a list of positive factors, such as {times: [0.5, 1, 2]}")
    if isinstance(base, bool) or not isinstance(base, int | float):
        raise ValueError(f"is {shortened(base)} in the base config, which has no multiples")
    values = [base * x for x in factors]
    if isinstance(base, int):
        values = [max(1, round(value)) for value in values]
    return OneOf(tuple(dict.fromkeys(values)))


def _range(low: float, high: float, log: bool, step: float | None = None) -> Range:
    if low > high:
        raise ValueError(f"goes from {low} to {high}: low must not be above high")
    if log and low <= 0:
        raise ValueError(f"starts at {low}, which has no logarithm: use a low above 0, or no log")
    if step is not None:
        if log:
            raise ValueError("has both log and step: leave one out")
        if step <= 0:
            raise ValueError(f"has step {step}: use one above 0")
        start, gap = Decimal(str(low)), Decimal(str(step))
        last = start + (Decimal(str(high)) - start) // gap * gap
        whole = all(isinstance(x, int) for x in (low, high, step))
        high = int(last) if whole else float(last)
    return Range(low, high, log, step)


def _check(name: str, value: Any, base: Config, source: str) -> None:
    """Raise MorlaxError unless an option may have this value in a trial."""
    kind = config_class(base.env, base.algorithm)
    values = merged(base.model_dump(mode="json"), nested(name, value))
    try:
        config = kind.model_validate(values)
    except ValidationError as error:
        if any(finding["loc"] for finding in error.errors()):
            raise MorlaxError(f"{source}: {explained(error, kind)}") from None
        return  # it may fit together with other values
    if config.task.for_evaluation() != base.task.for_evaluation():
        raise _uneven(source, name)


def _uneven(source: str, name: str) -> MorlaxError:
    return MorlaxError(
        f"{source} names {name}, which all trials share, so that they can be compared: leave it "
        "out."
    )
