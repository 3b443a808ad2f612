"""A trained family of policies, as other programs use it."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ..config import Config
from ..envs import MorlaxError
from ..tradeoffs import checked_tradeoff, one_tradeoff
from .agent import Agent, SpecializedPolicy


class Policy(nn.Module):
    """The deterministic policies of every trade-off.

    policy(observation, tradeoff) maps (B, O) and (m,) or (B, m) to actions (B, A) in (-1, 1); each
    row may have its own trade-off. Trade-offs need not sum to one, but must not be negative or all
    zero.
    """

    def __init__(self, agent: Agent, config: Config, objectives: Sequence[str]):
        super().__init__()
        self.agent, self.config, self.objectives = agent, config, tuple(objectives)

    @torch.no_grad()
    def forward(self, observation: Tensor, tradeoff: Tensor | Sequence[float]) -> Tensor:
        tradeoff = checked_tradeoff(tradeoff, self.objectives, observation.device)
        if tradeoff.ndim == 1:
            return self.agent.actors(tradeoff[None]).act(observation[None])[0]
        if len(tradeoff) != len(observation):
            raise MorlaxError(
                f"there are {len(observation)} observations but {len(tradeoff)} trade-offs: give "
                "one per observation, or one for all."
            )
        return self.agent.actors(tradeoff).act(observation[:, None])[:, 0]

    def specialize(self, tradeoff: Tensor | Sequence[float]) -> SpecializedPolicy:
        """Return a plain module for one trade-off (m,), with normalizer and tanh inside."""
        device = self.agent.observation_normalizer.mean.device
        fixed = self.agent.specialize(one_tradeoff(tradeoff, self.objectives, device))
        return fixed.requires_grad_(False)
