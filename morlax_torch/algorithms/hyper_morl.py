"""HYPER-MORL: first one balanced policy, then a hypernetwork around it."""

from typing import Any

import torch

from ..config import Config, HyperMORLOptions
from ..envs import Worlds
from ..networks.hypernetwork import Hypernetwork
from ..tradeoffs import even_tradeoffs, sample_cells
from .morlax import MORLAX


class HyperMORL(MORLAX):
    """Trains a single hypernetwork for actor and critic in two stages.

    (Shu et al., 2024, "Learning Pareto Set for Multi-Objective Continuous Robot Control".) A
    warm-up trains the balanced trade-off alone. Then its policy becomes the bias of the
    hypernetwork, Adam starts anew, and every iteration explores one random trade-off from each of K
    even cells of the simplex. docs/algorithms.md says what differs.

    Args:
        env: the worlds.
        config: with `network.type: single` and sparse sampling.
        networks: as of `MORLAX`.
    """

    def __init__(self, env: Worlds, config: Config, **networks: Any):
        super().__init__(env, config, **networks)
        assert isinstance(config.method, HyperMORLOptions) and config.max_env_steps
        warmup = config.method.warmup * config.max_env_steps
        self.warmup = round(warmup / self.steps_per_iteration)  # iterations
        self._centers = even_tradeoffs(*self.tradeoffs.shape).to(env.device)

    def draw_tradeoffs(self) -> None:
        sample_cells(self.tradeoffs, self._centers, self.generator)
        balanced = torch.full_like(self.tradeoffs, 1 / self.tradeoffs.shape[1])
        self.tradeoffs.copy_(torch.where(self.clock < self.warmup, balanced, self.tradeoffs))

    def iterate(self) -> None:
        super().iterate()
        if self.iteration == self.warmup:
            self._start_hypernetwork()

    def _start_hypernetwork(self) -> None:
        balanced = torch.full_like(self.tradeoffs[0], 1 / self.tradeoffs.shape[1])
        for family in (self.agent.actor, self.agent.critic):
            assert isinstance(family, Hypernetwork)
            family.collapse(balanced)
        for optimizer in self.ppo.optimizers:
            optimizer.forget()
