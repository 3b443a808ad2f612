"""Make the evaluator of a config's task, in training and after it."""

from ..configuration.config import Config
from ..configuration.tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs
from ..envs import MorlaxError, Worlds
from ..envs.devices import EVALUATION_SEEDS
from ..gpu.group import ALONE, Group
from ..networks.agent import Agent
from .evaluator import Evaluator, Protocol

DRAWN_TRADEOFFS = 1024  # of the paper's tables, and of D3PO's


def make_evaluator(
    agent: Agent,
    config: Config,
    num_objectives: int,
    protocol: Protocol = "latched",
    tradeoffs: int | None = None,
    seeds: int | None = None,
    seed: int = 0,
    sets: int = 1,
    group: Group = ALONE,
) -> Evaluator:
    """Make the evaluator of an agent, with the same worlds for every training seed.

    Trade-offs are an even grid for two objectives; the corners and fixed random draws for more;
    random draws with the protocols of published tables. None: the config's number, or their 1,024.
    `seeds` are episodes per trade-off and set; None: the config's number. For the other arguments
    see `Evaluator`.

    Raises:
        MorlaxError: a number is out of range, or nothing in the task is random although
            `seeds` > 1.
    """
    published = protocol != "latched"
    if tradeoffs is None:
        tradeoffs = DRAWN_TRADEOFFS if published else config.evaluation.tradeoffs
    seeds = config.evaluation.seeds if seeds is None else seeds
    points = evaluation_tradeoffs(tradeoffs, num_objectives)  # refuses too few
    if published:
        points = dirichlet_tradeoffs(tradeoffs, num_objectives)
    env = evaluation_worlds(config, tradeoffs, seeds, seed, sets, group)
    return Evaluator(agent, env, points, protocol, seed, seeds, sets, group)


def evaluation_worlds(
    config: Config, tradeoffs: int, seeds: int, seed: int = 0, sets: int = 1, group: Group = ALONE
) -> Worlds:
    """Make this process's share of an evaluator's worlds, one per episode; see `make_evaluator`."""
    if not 0 <= seed < 2**63:
        raise MorlaxError(f"seed is {seed}: it must be from 0 to 2^63 - 1.")
    if seeds < 1:
        raise MorlaxError(f"seeds is {seeds}: at least one is needed.")
    try:
        config.task.check_seeds(seeds)
    except ValueError as error:
        raise MorlaxError(f"{error}: leave out --seeds.") from None
    own = range(group.rank, tradeoffs * seeds * sets, group.size)
    return config.make_worlds(len(own), EVALUATION_SEEDS + seed, evaluating=True)
