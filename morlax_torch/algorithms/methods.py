"""MORLAX, and the baselines that train one agent: AMOR, HYPER-MORL and independent policies."""

from typing import Any

import torch

from ..configuration.tradeoffs import even_tradeoffs, sample_cells
from ..networks.gaussian import spread_of
from ..networks.hypernetwork import Hypernetwork
from .trainer import Trainer

WARMUP = 0.1  # share of a run of HYPER-MORL that trains the balanced trade-off only


class MORLAX(Trainer):
    """Trains an `Agent` in worlds, one `iterate` at a time.

    `state_dict` copies all state, and `load_state_dict` continues from a copy: bit for bit on the
    CPU, on CUDA up to the order of floating-point sums. `explore` and `learn` are the two halves
    of an iteration. On CUDA, call `compile` once, and they become recorded graphs.

    Building one on CUDA enables TF32 for matrix products in this process.

    Args:
        env: the worlds.
        config: every number of the run.
        actor: replaces the config's actor: a module from observations (B, O) to (B, 2A), means and
            spreads (see `TanhNormal`).
        critic: replaces the config's critic: a module from (B, O + P), with privileged features,
            to one value per objective (B, m), or to one value if `ppo.critic` is scalar.
        group: processes that train the same agent, each in its own worlds. It starts with the
            parameters and buffers of the first process.

    Raises:
        MorlaxError: config and worlds disagree, or a network does not fit the worlds.
    """

    algorithm = "morlax"  # users make it from any config

    def _draw(self) -> None:
        self._draws.fill(self.tradeoffs, self.generator, self._done)


class AMOR(Trainer):
    """Trains one conditioned actor and one conditioned critic with MORLAX's updates.

    (Alegre et al., 2025, "AMOR: Adaptive Character Control through Multi-Objective Reinforcement
    Learning".) With dense sampling every world keeps its trade-off until its episode ends. It needs
    `network.type: conditioned`.
    """

    def _build(self) -> None:
        super()._build()
        self._ended = torch.ones(len(self.tradeoffs), 1, dtype=torch.bool, device=self.env.device)
        self._process_state |= {"tradeoffs": [self.tradeoffs], "ended": [self._ended]}

    def iterate(self, done: float = 0.0) -> None:
        super().iterate(done)
        ended = self.rollout.terminated | self.rollout.truncated
        self._ended.copy_(ended.any(0).any(1, keepdim=True))

    def _draw(self) -> None:
        before = self.tradeoffs.clone()
        self._draws.fill(self.tradeoffs, self.generator, self._done)
        if self.config.sampling.mode == "dense":
            self.tradeoffs.copy_(torch.where(self._ended, self.tradeoffs, before))


class IndependentPPO(Trainer):
    """Trains K policies that share no parameters, each for one of K evenly spread trade-offs.

    Each is plain PPO (Schulman et al., 2017) in its own worlds, with its own advantages, gradient
    norm and moments of Adam; only the normalizers of observations and values see all worlds. It
    needs `network.type: independent` and sparse sampling.
    """

    def _build(self) -> None:
        super()._build()
        self.tradeoffs.copy_(even_tradeoffs(*self.tradeoffs.shape))


class HyperMORL(Trainer):
    """Trains a single hypernetwork for actor and critic in two stages.

    (Shu et al., 2024, "Learning Pareto Set for Multi-Objective Continuous Robot Control".) A
    warm-up trains the balanced trade-off alone. Then its policy becomes the bias of the
    hypernetwork, and every iteration explores one random trade-off from each of K even cells of the
    simplex. It needs `network.type: single` and sparse sampling.
    """

    def _build(self) -> None:
        super()._build()
        self._centers = even_tradeoffs(*self.tradeoffs.shape).to(self.env.device)
        self.warming_up = True
        self._warming_up = torch.ones((), dtype=torch.bool, device=self.env.device)  # for graphs

    def iterate(self, done: float = 0.0) -> None:
        if self.warming_up and done >= WARMUP:
            self.warming_up = False
            self._start_hypernetwork()
        self._warming_up.fill_(self.warming_up)
        start, end = (0.0, WARMUP) if self.warming_up else (WARMUP, 1.0)
        stage_done = (done - start) / (end - start) if end > start else 1.0
        super().iterate(stage_done)

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "warming_up": self.warming_up}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.warming_up = state["warming_up"]

    def _draw(self) -> None:
        sample_cells(self.tradeoffs, self._centers, self.generator)
        balanced = 1 / self.tradeoffs.shape[1]
        self.tradeoffs.copy_(torch.where(self._warming_up, balanced, self.tradeoffs))

    def _start_hypernetwork(self) -> None:
        balanced = torch.full_like(self.tradeoffs[0], 1 / self.tradeoffs.shape[1])
        actor, critic = self.agent.actor, self.agent.critic
        assert isinstance(actor, Hypernetwork) and isinstance(critic, Hypernetwork)
        actor.collapse(balanced)
        critic.collapse(balanced)
        # a user's own actor may make standard deviations in any way: it keeps those of the warm-up
        if "actor" not in self.agent.own_networks():
            weight, bias = list(actor.split(actor.bias.detach()).values())[-2:]
            weight[self.env.action_size :] = 0.0
            bias[self.env.action_size :] = spread_of(self.config.network.initial_std)
        for optimizer in self.ppo.optimizers:
            optimizer.restart()
