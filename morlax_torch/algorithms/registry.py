"""The learners by name."""

from collections.abc import Callable
from typing import Any

from ..configuration.config import Config
from ..envs import MorlaxError, Worlds
from .hyper_sac import HyperSAC
from .learner import Learner
from .methods import AMOR, MORLAX, HyperMORL, IndependentPPO

LEARNERS: dict[str, Callable[..., Learner]] = {
    "morlax": MORLAX,
    "hyper-sac": HyperSAC,
    "amor": AMOR,
    "hyper-morl": HyperMORL,
    "independent": IndependentPPO,
}


def make_learner(env: Worlds, config: Config, **others: Any) -> Learner:
    """Make the learner of the config's algorithm; `MORLAX` explains the arguments and errors."""
    if config.algorithm == "rsl-rl":
        raise MorlaxError("algorithm rsl-rl trains in rsl_rl's own runner (docs/rsl-rl.md).")
    return LEARNERS[config.algorithm](env, config, **others)
