"""AMOR: one network that takes the trade-off as an input."""

from typing import Any

import torch

from ..configuration.config import Config
from ..envs import Worlds
from .morlax import MORLAX


class AMOR(MORLAX):
    """Trains one conditioned actor and one conditioned critic with MORLAX's updates.

    (Alegre et al., 2025, "AMOR: Adaptive Character Control through Multi-Objective Reinforcement
    Learning".) With dense sampling every world keeps its trade-off until its episode ends; it draws
    the next one at the start of the following rollout. docs/algorithms.md says what differs.

    Args:
        env: the worlds.
        config: with `network.type: conditioned`.
        others: as of `MORLAX`.
    """

    per_process = (*MORLAX.per_process, "tradeoffs", "ended")

    def __init__(self, env: Worlds, config: Config, **others: Any):
        super().__init__(env, config, **others)
        self._ended = torch.ones(len(self.tradeoffs), 1, dtype=torch.bool, device=env.device)

    def draw_tradeoffs(self) -> None:
        kept = self.tradeoffs.clone()
        super().draw_tradeoffs()
        if self.config.sampling.mode == "dense":
            self.tradeoffs.copy_(torch.where(self._ended, self.tradeoffs, kept))

    def _learn(self, epochs: int | None = None) -> None:
        super()._learn(epochs)
        ended = self.rollout.terminated | self.rollout.truncated
        self._ended.copy_(ended.any(0).any(1, keepdim=True))

    def state_dict(self) -> dict[str, Any]:
        own = {"tradeoffs": self.tradeoffs.clone(), "ended": self._ended.clone()}
        return {**super().state_dict(), **own}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.tradeoffs.copy_(state["tradeoffs"])
        self._ended.copy_(state["ended"])
