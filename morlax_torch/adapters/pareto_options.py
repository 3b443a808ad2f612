"""The options of `ParetoPPO`."""

import os
from typing import Any

from pydantic import BaseModel, ConfigDict, NonNegativeInt, PositiveInt

from ..configuration.files import read_yaml
from ..envs.errors import validated
from ..envs.worlds.options import Objectives

FILE = "MORLAX_PARETO"  # environment variable: a YAML file of `ParetoOptions`
UNSET = (None, (), [], "")  # values of options that a host leaves to us


class ParetoOptions(BaseModel):
    """The options of `ParetoPPO`, beside those of PPO in the section `algorithm`."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    objectives: Objectives | None = None
    """Per objective, the factor of each of its reward terms, as the host pays them; names may be
    patterns such as track_*. None: all positive terms, rewards, against the negative, costs."""
    guide: dict[str, float] | None = None
    """Factors of the terms that every trade-off learns from; {}: nothing. None: the terms that no
    objective has; without objectives, all terms."""
    terms: str | None = None
    """MODULE:FUNCTION, which maps the environment to its reward terms of the last step, name ->
    (N,), or any before the first one; for hosts without a reward manager or reward functions."""
    tradeoffs: PositiveInt = 32
    """K, trade-offs that learn at a time; each has every K-th world."""
    features: PositiveInt = 6
    """F, the number of features that generated parameters are affine in. A family has F + 1 times
    the parameters of one policy."""
    focus: tuple[float, ...] | None = None
    """The trade-off where training starts as plain PPO. None: the balanced one, which has the
    host's weights if neither objectives nor guide are given."""
    warmup: NonNegativeInt = 150
    """Rollouts that learn the focus alone, before they learn K trade-offs."""
    evaluation_worlds: NonNegativeInt = 256
    """Worlds that show the front instead of learning, eight for each trade-off of a fixed grid."""
    reference_point: tuple[float, ...] | None = None
    """Of the hypervolume (None: the worst returns so far, so that curves cannot be compared)."""
    task: str | None = None
    """The task as morlax calls it, such as mjlab:TASK, so that its commands open checkpoints."""


def take_options(algorithm: dict[str, Any]) -> ParetoOptions:
    """Take our options out of rsl_rl's section `algorithm`, under those of the file."""
    values = {name: algorithm.pop(name) for name in ParetoOptions.model_fields if name in algorithm}
    values = {name: value for name, value in values.items() if value not in UNSET}
    if path := os.environ.get(FILE):
        values |= read_yaml(path, f"{FILE} file", "tradeoffs: 32")
    return validated(ParetoOptions, values)
