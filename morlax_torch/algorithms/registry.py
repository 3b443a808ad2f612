"""The learners by name."""

from torch import nn

from ..configuration.config import Config
from ..envs import Worlds
from ..gpu.group import ALONE, Group
from .learner import Learner
from .methods import AMOR, MORLAX, HyperMORL, IndependentPPO
from .off_policy.hyper_sac import HyperSAC
from .off_policy.learner import OffPolicy
from .off_policy.pd_morl import PDMORL
from .pg_morl.learner import PGMORL
from .trainer import Trainer

LEARNERS: dict[str, type[Trainer] | type[OffPolicy]] = {
    "morlax": MORLAX,
    "hyper-sac": HyperSAC,
    "amor": AMOR,
    "hyper-morl": HyperMORL,
    "pg-morl": PGMORL,
    "pd-morl": PDMORL,
    "independent": IndependentPPO,
}


def make_learner(
    env: Worlds,
    config: Config,
    actor: nn.Module | None = None,
    critic: nn.Module | None = None,
    *,
    group: Group = ALONE,
) -> Learner:
    """Make the learner of the config's algorithm; `MORLAX` explains the arguments and errors."""
    return LEARNERS[config.algorithm](env, config, actor=actor, critic=critic, group=group)
