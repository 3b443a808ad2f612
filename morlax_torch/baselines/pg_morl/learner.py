"""PG-MORL: a population of policies, trained where a model predicts the best front."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...algorithms.learner import copies, make_agent, restore
from ...algorithms.trainer import Trainer
from ...configuration.config import Config
from ...configuration.tradeoffs import even_tradeoffs
from ...envs import Worlds
from ...evaluation.evaluator import Evaluator, evaluation_worlds
from ...gpu.group import ALONE, Group
from ...networks.agent import Agent
from ...networks.family import Independent
from .agent import belongings
from .options import PGMORLOptions
from .population import (
    candidate_weights,
    directions,
    pareto_archive,
    performance_buffer,
    predict,
    select,
)

REMEMBERED = 4096  # generations of a policy that predictions rest on
MEASURING = 1  # seed of the episodes that policies are measured in; 0 is that of evaluations
SHARE = 0.08  # of the run's time, at most, to measure policies
SPACING = 20  # iterations, at least, between two snapshots of a policy
# A step of few worlds takes as long as the training on a step of so many worlds. On an H200 it was
# 2,500 to 3,900, with the time of the selection: see docs/algorithms.md.
LATENCY = {"cpu": 1, "cuda": 3900}


class PGMORL(Trainer):
    """Trains K policies at a time, and every generation chooses which, and with what trade-offs.

    (Xu et al., 2020, "Prediction-Guided Multi-Objective Reinforcement Learning for Continuous
    Robot Control".) docs/algorithms.md explains it. The agent is the archive, `trained` the K
    policies. Every policy has its own normalizers, which go with it, so that it stays what was
    measured.

    It needs `network.type: independent` and sparse sampling, and takes the arguments of `MORLAX`.
    """

    def __init__(self, env: Worlds, config: Config, *, group: Group = ALONE, **networks: Any):
        trained = make_agent(env, config, in_order=config.num_clusters, **networks)
        super().__init__(env, config, group=group, agent=trained)
        self.tradeoffs.copy_(even_tradeoffs(*self.tradeoffs.shape))
        self.agent = make_agent(env, config, **networks)  # the archive
        group.share(self.agent)
        assert isinstance(config.method, PGMORLOptions)
        self.options = config.method
        K, m = self.tradeoffs.shape
        self._directions = directions(self.options.bins, m)
        self.generation, self._spacing = intervals(config, env.episode_length, env.device.type)
        number = K * math.ceil(self.generation / self._spacing)  # of snapshots
        self._measured = make_agent(env, config, in_order=number, **networks)
        self._evaluator = measuring(self._measured, config, m)
        moments = [x.new_zeros(number, x.shape[1]) for x in self._moments()]
        self._snapshots = [*belongings(self._measured), *moments]
        double = partial(torch.zeros, dtype=torch.float64)
        # Returns (p, m) of the population's p members, trade-offs (p, m) that they were last
        # trained with, candidates (p, c) that they have been trained with since, and themselves.
        untried = torch.zeros(0, self.options.candidates, dtype=torch.bool)
        members = [x.new_zeros(0, *x.shape[1:]) for x in self._snapshots]
        self._population = [double(0, m), double(0, m), untried, *members]
        self._archived = double(0, m)  # returns of the archive
        self._start = double(K, m)  # returns of the K policies before this generation
        self._history = double(0, 3, m)  # returns before, weights, change of returns

    def compile(self) -> None:
        super().compile()
        self._evaluator.compile()

    def iterate(self, done: float = 0.0) -> None:
        if self.iteration == 0:
            self._keep_snapshot(0)
            self._start.copy_(self._measure()[-len(self.tradeoffs) :])
        super().iterate(done)
        left = -self.iteration % self.generation  # iterations until the generation ends
        if left % self._spacing == 0:
            self._keep_snapshot(left // self._spacing)
        if left == 0:
            self._end_generation()

    def _keep_snapshot(self, later: int) -> None:
        """Copy the policies in training; so many snapshots follow in this generation."""
        K = len(self.tradeoffs)
        end = len(self._snapshots[0]) - later * K
        for snapshots, values in zip(self._snapshots, self._belongings(), strict=True):
            snapshots[end - K : end] = values

    def _measure(self) -> Tensor:
        """Return the returns (S, m) of the snapshots, the same in every process."""
        return self.group.first(torch.from_numpy(self._evaluator.evaluate().returns))

    def _end_generation(self) -> None:
        weights, returns = self.tradeoffs.double().cpu(), self._measure()
        K = len(weights)
        last = returns[-K:]
        stretches = torch.stack([self._start, weights, last - self._start], 1)
        self._history = torch.cat([self._history, stretches])[-REMEMBERED:]
        self._join_archive(returns)
        self._join_population(returns, weights.repeat(len(returns) // K, 1))
        self._start.copy_(last)
        if self.iteration >= self.options.warmup and len(self._population[0]):
            self._choose()

    def _join_archive(self, returns: Tensor) -> None:
        """Let the snapshots join the archive, which is the agent that is evaluated."""
        joined = torch.cat([self._archived, returns])
        kept = pareto_archive(joined.numpy(), self.config.num_networks)
        archive, before, size = belongings(self.agent), len(self._archived), len(kept)
        policies = [values[:before] for values in archive]
        rows = _joined(policies, self._snapshots[: len(archive)], kept)
        for values, new in zip(archive, rows, strict=True):
            values[:size] = new
        self._archived = joined[kept]
        for family in (self.agent.actor, self.agent.critic):
            assert isinstance(family, Independent)
            family.keys[:size] = self._archived.to(family.keys)
            family.offsets.fill_(-torch.finfo(torch.float32).max)
            family.offsets[:size] = 0.0

    def _join_population(self, returns: Tensor, weights: Tensor) -> None:
        """Let the snapshots join the population, and keep the best of it."""
        joined = torch.cat([self._population[0], returns])
        point = self._evaluator.reference_point
        kept = performance_buffer(joined.numpy(), point, self._directions, self.options.bin_size)
        untried = torch.zeros(len(returns), self.options.candidates, dtype=torch.bool)
        added = [returns, weights, untried, *self._snapshots]
        self._population = _joined(self._population, added, kept)

    def _choose(self) -> None:
        """Choose what the next generation trains."""
        returns, weights, tried, *members = self._population
        before, trained, change = self._history.numpy().transpose(1, 0, 2)
        around, valid = candidate_weights(weights.numpy(), self.options.candidates)
        valid &= ~tried.numpy()
        if not valid.any():
            return
        predicted = predict(before, trained, change, returns.numpy(), around)
        chosen = select(
            returns.numpy(),
            predicted[valid],
            len(self.tradeoffs),
            self._evaluator.reference_point,
            self.options.sparsity,
        )
        # with too few candidates, the best are trained twice
        pairs = np.argwhere(valid)[np.resize(chosen, len(self.tradeoffs))]
        # hosts whose processors round differently may choose differently
        rows, candidates = self.group.first(pairs).T
        tried[rows, candidates] = True
        picked = torch.from_numpy(rows)
        self.tradeoffs.copy_(torch.from_numpy(around[rows, candidates]))
        self._start.copy_(returns[picked])
        for values, stored in zip(self._belongings(), members, strict=True):
            values.copy_(stored[picked.to(stored.device)])

    def _belongings(self) -> list[Tensor]:
        """Return views (K, ...) of all that belongs to each policy in training."""
        return [*belongings(self.trained), *self._moments()]

    def _moments(self) -> list[Tensor]:
        """Return views (K, n) of the moments of Adam."""
        moments = [x for adam in self.ppo.optimizers for x in (adam.mean, adam.square)]
        return [x.view(self.config.num_clusters, -1) for x in moments]

    def state_dict(self) -> dict[str, Any]:
        state = super().state_dict()
        population = {
            "members": copies(self._population),
            "returns": copies([self._archived, self._start, self._history]),
            "snapshots": copies(self._snapshots),
            "trained": state["agent"],
            "tradeoffs": self.tradeoffs.clone(),
        }
        archive = {name: value.clone() for name, value in self.agent.state_dict().items()}
        return {**state, "agent": archive, "population": population}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        stored = state["population"]
        super().load_state_dict({**state, "agent": stored["trained"]})
        self.agent.load_state_dict(state["agent"])
        pairs = zip(self._population, stored["members"], strict=True)
        self._population = [value.to(mine.device, copy=True) for mine, value in pairs]
        self._archived, self._start, self._history = copies(stored["returns"])
        restore(self._snapshots, stored["snapshots"])
        self.tradeoffs.copy_(stored["tradeoffs"])


def intervals(config: Config, episode_length: int, device_type: str) -> tuple[int, int]:
    """Return the iterations of a generation, and those between two snapshots of a policy.

    Both are as few as SPACING and the SHARE of time for measuring allow. Time counts as steps of
    one world, so that all processes and repeated runs agree.
    """
    assert isinstance(config.method, PGMORLOptions)
    allowed = SHARE / (1 - SHARE) * config.worlds * config.horizon  # steps of each iteration
    each = config.num_clusters * episode_length / allowed
    spacing = max(SPACING, math.ceil(each))
    if config.method.generation is not None:
        return config.method.generation, spacing
    return max(spacing, math.ceil(LATENCY[device_type] * episode_length / allowed)), spacing


def measuring(agent: Agent, config: Config, num_objectives: int) -> Evaluator:
    """Return the evaluator of an agent's policies, which come in a row."""
    worlds = evaluation_worlds(config, agent.num_networks, seeds=1, seed=MEASURING)
    shape = agent.num_networks, num_objectives
    unused = torch.full(shape, 1 / num_objectives, dtype=torch.float32)
    return Evaluator(agent, worlds, unused, config.evaluation.protocol, seed=MEASURING)


def _joined(
    tables: Sequence[Tensor], added: Sequence[Tensor], kept: NDArray[np.intp]
) -> list[Tensor]:
    """Return the `kept` ones of the rows of each table and of those added to it."""
    rows = torch.from_numpy(kept)
    pairs = zip(tables, added, strict=True)
    return [torch.cat(pair)[rows.to(pair[0].device)] for pair in pairs]
