"""The settings that all trials of a study share, so that they can be compared, and pruning."""

import json
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Self, get_args

from ..configuration.config import Config, load_config
from ..configuration.files import merged
from ..envs import MorlaxError
from ..evaluation.front import hypervolume_in
from .space import Space
from .storage import optuna

Indicator = Literal["hypervolume", "expected_utility", "sparsity", "obedience", "cardinality"]
MINIMIZED = ("sparsity",)
FIRST, REDUCTION = 1 / 9, 3  # a third of the trials goes on after 1/9 and 1/3 of the time
EVALUATED = (FIRST, REDUCTION * FIRST, 2 / 3)  # shares of the time, beside its start and its end


class Plan(NamedTuple):
    base: Config
    space: Space
    indicators: tuple[Indicator, ...]

    @classmethod
    def of(
        cls,
        config: Config,
        space: Mapping[str, Any],
        seconds: float,
        indicators: tuple[Indicator, ...],
        source: str,
    ) -> Self:
        """Check and return a plan; limits and evaluation times of `config` are replaced.

        Error messages call the space `source`.

        Raises:
            MorlaxError: the space or an indicator cannot be used.
        """
        if not indicators or len(set(indicators)) < len(indicators):
            raise MorlaxError("name at least one indicator, and each only once.")
        for name in indicators:
            if name not in get_args(Indicator):
                raise MorlaxError(f"{name!r} is none of {', '.join(get_args(Indicator))}.")
        limits = {"max_seconds": seconds, "max_env_steps": None, "evaluation": {"every": None}}
        base = load_config(merged(config.model_dump(mode="json"), limits))
        return cls(base, Space.of(space, base, source), indicators)

    @property
    def main(self) -> str:
        return self.indicators[0] if len(self.indicators) == 1 else "hypervolume"

    @property
    def sign(self) -> int:
        """1 if more of the main indicator is better, else -1."""
        return -1 if self.main in MINIMIZED else 1

    @property
    def directions(self) -> list[Literal["minimize", "maximize"]]:
        return ["minimize" if name in MINIMIZED else "maximize" for name in self.indicators]

    def measured(self, found: Mapping[str, float]) -> dict[str, float]:
        values = {**found, "hypervolume": found[hypervolume_in(found)]}
        return {name: float(values[name]) for name in get_args(Indicator)}

    def description(self) -> dict[str, Any]:
        """Return plain values that are equal if trials can be compared."""
        distributions = self.space.distributions.items()
        space = {
            name: json.loads(optuna.distributions.distribution_to_json(each))
            for name, each in distributions
        }
        config = self.base.model_dump(mode="json", exclude={"device"})
        return json.loads(
            json.dumps({"config": config, "space": space, "indicators": self.indicators})
        )


def make_pruner(seconds: float) -> optuna.pruners.BasePruner:
    """Return a pruner whose steps are those of `step`."""
    first = max(1, step(FIRST * seconds))
    return optuna.pruners.SuccessiveHalvingPruner(first, REDUCTION)


def step(train_seconds: float) -> int:
    """Return training time in milliseconds."""
    return int(1000 * train_seconds)
