"""HYPER-MORL: first one balanced policy, then a hypernetwork around it."""

from typing import Any

import torch

from ..config import Config
from ..config_sections import HyperMORLOptions
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
        others: as of `MORLAX`.
    """

    def __init__(self, env: Worlds, config: Config, **others: Any):
        super().__init__(env, config, **others)
        self._centers = even_tradeoffs(*self.tradeoffs.shape).to(env.device)
        self.warming_up = True
        self._warming_up = torch.ones((), dtype=torch.bool, device=env.device)  # for graphs

    def draw_tradeoffs(self) -> None:
        sample_cells(self.tradeoffs, self._centers, self.generator)
        balanced = torch.full_like(self.tradeoffs, 1 / self.tradeoffs.shape[1])
        self.tradeoffs.copy_(torch.where(self._warming_up, balanced, self.tradeoffs))

    def iterate(self, done: float = 0.0) -> None:
        assert isinstance(self.config.method, HyperMORLOptions)
        if self.warming_up and done >= self.config.method.warmup:
            self.warming_up = False
            self._warming_up.fill_(False)
            self._start_hypernetwork()
        super().iterate(done)

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "warming_up": self.warming_up}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.warming_up = state["warming_up"]
        self._warming_up.fill_(self.warming_up)

    def _start_hypernetwork(self) -> None:
        balanced = torch.full_like(self.tradeoffs[0], 1 / self.tradeoffs.shape[1])
        for family in (self.agent.actor, self.agent.critic):
            assert isinstance(family, Hypernetwork)
            family.collapse(balanced)
        for optimizer in self.ppo.optimizers:
            optimizer.forget()
