"""PG-MORL: a population of policies, trained where a model predicts the best front."""

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...config import Config
from ...config_sections import PGMORLOptions
from ...envs import Worlds, make
from ...envs.random import EVALUATION_SEEDS
from ...evaluation.evaluator import Evaluator
from ...networks.agent import Agent
from ...networks.independent import Independent, InOrder
from ...tradeoffs import even_tradeoffs
from ..morlax import MORLAX
from .population import candidate_weights, directions, performance_buffer
from .prediction import predict
from .selection import select

REMEMBERED = 4096  # stretches of training that predictions rest on
MEASURING = 1  # seed of the episodes that policies are measured in; 0 is that of evaluations


class PGMORL(MORLAX):
    """Trains K policies at a time, and every generation chooses which, and with what trade-offs.

    (Xu et al., 2020, "Prediction-Guided Multi-Objective Reinforcement Learning for Continuous
    Robot Control".) After a generation of training, the K policies are measured and join the
    population, which keeps the best in each direction of the objective space. A model predicts how
    the returns of each member would change under several trade-offs, and the K pairs of member and
    trade-off are trained next that together promise the best front. A trade-off gets the member
    with the largest weighted return. docs/algorithms.md says what differs.

    Args:
        env: the worlds.
        config: with `network.type: independent` and sparse sampling.
        others: as of `MORLAX`.
    """

    def __init__(self, env: Worlds, config: Config, **others: Any):
        self._networks = {name: others.get(name) for name in ("actor", "critic")}
        super().__init__(env, config, **others)
        assert isinstance(config.method, PGMORLOptions)
        self.options = config.method
        K, m = self.tradeoffs.shape
        self.tradeoffs.copy_(even_tradeoffs(K, m))
        self._directions = directions(self.options.bins, m)
        self._evaluator = self._make_evaluator()
        capacity, numbers = config.num_networks, sum(part.shape[1] for part in self._parts())
        double = partial(torch.zeros, dtype=torch.float64)
        self._state = {
            "members": torch.zeros(capacity, numbers, device=env.device),
            "returns": double(capacity, m),
            "weights": double(capacity, m),  # that members were last trained with
            # candidates that members have been trained with since
            "tried": torch.zeros(capacity, self.options.candidates, dtype=torch.bool),
            "start": double(K, m),  # returns of the K policies before this generation
            "history": double(REMEMBERED, 3, m),  # returns before, weights, change of returns
        }
        self._size = self._stretches = 0

    def make_trained(self) -> Agent:
        config, env = self.config, self.env
        trained = Agent.of(
            config,
            env.observation_size,
            env.action_size,
            len(env.objectives),
            torch.Generator().manual_seed(config.seed),
            privileged_size=env.privileged_size,
            in_order=True,
            **self._networks,
        ).to(env.device)
        # the population sees what they see
        trained.observation_normalizer = self.agent.observation_normalizer
        return trained

    def draw_tradeoffs(self) -> None:
        """Keep those of the generation."""

    def compile(self) -> None:
        super().compile()
        self._evaluator.compile()

    def iterate(self, done: float = 0.0) -> None:
        if self.iteration == 0:
            self._state["start"].copy_(self._measure())
        super().iterate(done)
        if self.iteration % self.options.generation == 0:
            self._end_generation()

    def _make_evaluator(self) -> Evaluator:
        config = self.config
        worlds = make(
            config.env,
            config.num_clusters,
            self.env.device,
            config.backend,
            EVALUATION_SEEDS + MEASURING,
            auto_reset=False,
            deterministic=config.deterministic,
            **config.task.for_evaluation().model_dump(),
        )
        return Evaluator(self.trained, worlds, self.tradeoffs, seed=MEASURING)

    def _measure(self) -> Tensor:
        """Return the returns (K, m) of the policies in training, the same in every process."""
        return self.group.first(torch.from_numpy(self._evaluator.evaluate().returns))

    def _end_generation(self) -> None:
        returns, weights = self._measure(), self.tradeoffs.double().cpu()
        self._remember(returns, weights)
        self._join(returns, weights)
        self._show_population()
        self._state["start"].copy_(returns)
        if self.iteration >= self.options.warmup and self._size:
            self._choose()

    def _remember(self, returns: Tensor, weights: Tensor) -> None:
        history, start = self._state["history"], self._state["start"]
        places = (self._stretches + torch.arange(len(returns))) % REMEMBERED
        history[places] = torch.stack([start, weights, returns - start], 1)
        self._stretches += len(returns)

    def _join(self, returns: Tensor, weights: Tensor) -> None:
        """Let the trained policies join the population, and keep the best of it."""
        size, state = self._size, self._state
        joined = torch.cat([state["returns"][:size], returns])
        point = self.env.reference_point
        kept = performance_buffer(joined.numpy(), point, self._directions, self.options.bin_size)
        rows = torch.cat([state["members"][:size], torch.cat(self._parts(), 1)])
        untried = torch.zeros(len(returns), self.options.candidates, dtype=torch.bool)
        values = {
            "members": rows,
            "returns": joined,
            "weights": torch.cat([state["weights"][:size], weights]),
            "tried": torch.cat([state["tried"][:size], untried]),
        }
        for name, value in values.items():
            state[name][: len(kept)] = value[torch.from_numpy(kept).to(value.device)]
        self._size = len(kept)

    def _show_population(self) -> None:
        """Give the population to the agent that is evaluated."""
        if not self._size:
            return
        members, first = self._state["members"][: self._size], 0
        for family in (self.agent.actor, self.agent.critic):
            assert isinstance(family, Independent)
            last = first + family.rows.shape[1]
            with torch.no_grad():
                family.rows[: self._size] = members[:, first:last]
                family.keys[: self._size] = self._state["returns"][: self._size].to(family.keys)
                family.offsets.fill_(-torch.finfo(torch.float32).max)
                family.offsets[: self._size] = 0.0
            first = last

    def _choose(self) -> None:
        """Choose what the next generation trains."""
        state, size = self._state, self._size
        history = state["history"][: min(self._stretches, REMEMBERED)].numpy()
        before, weights, change = history.transpose(1, 0, 2)
        returns = state["returns"][:size].numpy()
        around, valid = candidate_weights(state["weights"][:size].numpy(), self.options.candidates)
        valid &= ~state["tried"][:size].numpy()
        if not valid.any():
            return
        predicted = predict(before, weights, change, returns, around)
        chosen = select(
            returns,
            predicted[valid],
            len(self.tradeoffs),
            self.env.reference_point,
            self.options.sparsity,
        )
        # with too few candidates, the best are trained twice
        members, candidates = np.argwhere(valid)[np.resize(chosen, len(self.tradeoffs))].T
        state["tried"][members, candidates] = True
        picked = torch.from_numpy(members)
        self.tradeoffs.copy_(torch.from_numpy(around[members, candidates]))
        state["start"].copy_(state["returns"][picked])
        columns = state["members"][picked.to(self.env.device)]
        parts = self._parts()
        with torch.no_grad():
            for part, own in zip(
                parts, columns.split([part.shape[1] for part in parts], 1), strict=True
            ):
                part.copy_(own)

    def _parts(self) -> list[Tensor]:
        """Return views (K, ...) of all that belongs to each policy: parameters and moments."""
        families = self.trained.actor, self.trained.critic
        rows = [family.rows.detach() for family in families if isinstance(family, InOrder)]
        moments = [
            x for optimizer in self.ppo.optimizers for x in (optimizer.mean, optimizer.square)
        ]
        return [*rows, *(x.view(self.config.num_clusters, -1) for x in moments)]

    def state_dict(self) -> dict[str, Any]:
        own = {name: value.clone() for name, value in self._state.items()}
        trained = {name: value.clone() for name, value in self.trained.state_dict().items()}
        counts = {"size": self._size, "stretches": self._stretches}
        return {
            **super().state_dict(),
            "population": {
                **own,
                **counts,
                "trained": trained,
                "tradeoffs": self.tradeoffs.clone(),
            },
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        stored = state["population"]
        for name, value in self._state.items():
            value.copy_(stored[name])
        self.trained.load_state_dict(stored["trained"])
        self.tradeoffs.copy_(stored["tradeoffs"])
        self._size, self._stretches = stored["size"], stored["stretches"]
