"""Make the evaluator of a config's task, in training and after it."""

import numpy as np
import torch
from torch import Tensor

from ..configuration.config import Config
from ..configuration.sections import Protocol
from ..configuration.tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs
from ..envs import MorlaxError, Worlds
from ..envs.devices import EVALUATION_SEEDS
from ..envs.worlds.design_space import DesignSpace, compile_bank
from ..envs.worlds.environment import Environment
from ..gpu.group import ALONE, Group
from ..networks.agent import Agent
from .evaluator import Evaluator, share

HELD_OUT = 2**62  # seed of the designs to evaluate with, which no training has
DRAWN_TRADEOFFS = 1024  # of the paper's tables, and of D3PO's


def usual_tradeoffs(config: Config, protocol: Protocol) -> int:
    """Return the config's number of trade-offs, or that of published tables by their protocols."""
    of_config = protocol in ("latched", config.evaluation.protocol)
    return config.evaluation.tradeoffs if of_config else DRAWN_TRADEOFFS


def make_evaluator(
    agent: Agent,
    config: Config,
    num_objectives: int,
    protocol: Protocol | None = None,
    tradeoffs: int | None = None,
    seeds: int | None = None,
    seed: int = 0,
    sets: int = 1,
    group: Group = ALONE,
    bodies: int = 1,
) -> Evaluator:
    """Make the evaluator of an agent, with the same worlds for every training seed.

    `protocol`, `tradeoffs` and `seeds` (episodes per trade-off and set) are those of the config if
    they are None. With several `bodies`, that of the agent's context comes first, and fronts hold
    all trade-offs of one body after the other. For the other arguments see `Evaluator`.
    """
    protocol = config.evaluation.protocol if protocol is None else protocol
    config.check_protocol(protocol)
    tradeoffs = usual_tradeoffs(config, protocol) if tradeoffs is None else tradeoffs
    seeds = config.evaluation.seeds if seeds is None else seeds
    points = evaluation_tradeoffs(tradeoffs, num_objectives)  # refuses too few
    if protocol != "latched":
        points = dirichlet_tradeoffs(tradeoffs, num_objectives)
    env = evaluation_worlds(config, tradeoffs * bodies, seeds, seed, sets, group)
    if bodies > 1:
        assert isinstance(env, Environment)
        points = points.repeat(bodies, 1)
        rows = torch.arange(bodies).repeat_interleave(tradeoffs)
        designs = held_out(env, bodies)
        if not embody(env, designs, share(rows[:, None], seeds * sets, group)[:, 0]).all():
            raise MorlaxError(f"not all of {bodies} designs to evaluate with make a body.")
        contexts = torch.from_numpy(DesignSpace(env.designs).scaled(designs)).float()
        points = torch.cat([points, contexts[rows]], -1)
    return Evaluator(agent, env, points, protocol, seed, seeds, sets, group)


def held_out(env: Environment, number: int) -> np.ndarray:
    """Return designs (number, d): first the one of the worlds, then others, spread evenly."""
    space = DesignSpace(env.designs)
    return np.vstack([space.vector(env.options.design), space.spread(number - 1, HELD_OUT)])


def embody(env: Environment, designs: np.ndarray, rows: Tensor) -> np.ndarray:
    """Give the worlds the bodies of designs (D, d) by row (N,), in new episodes.

    Returns which designs make a body, (D,) bool. Worlds of another one get any body.
    """
    bank = compile_bank(env, designs)
    env.adopt(bank)
    places = torch.from_numpy((bank.kept.cumsum() - 1).clip(min=0)).to(env.device)  # in the bank
    everywhere = torch.ones_like(env.age, dtype=torch.bool)
    env.embody(places[rows.to(env.device)], everywhere)
    return bank.kept


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
    number = len(range(group.rank, tradeoffs * seeds * sets, group.size))
    return config.make_worlds(number, EVALUATION_SEEDS + seed, evaluating=True)
