"""What a policy is expected to return, by its critic."""

import torch
from torch import Tensor

from ..networks.agent import Agent


@torch.no_grad()
def expected_returns(
    agent: Agent,
    tradeoffs: Tensor,
    starts: Tensor,
    discount: float,
    episode_length: int,
    normalized: bool,
) -> Tensor:
    """Estimate the undiscounted returns (K, m) of whole episodes.

    A discounted value V of T steps with the same reward is (1 - gamma^T) / (1 - gamma) times that
    reward, and the undiscounted return is T times. So V is scaled by the ratio of the two.

    Args:
        agent: its critics estimate V.
        tradeoffs: (K, m)
        starts: first observations of episodes, (K, S, O + P).
        discount: gamma, per control step.
        episode_length: T
        normalized: whether the critics predict normalized values.
    """
    value = agent.values(tradeoffs)(agent.observation_normalizer(starts))
    if normalized:
        value = agent.value_normalizer.inverse(value)
    steps = float(episode_length)
    if discount < 1:
        steps = (1 - discount**episode_length) / (1 - discount)
    return value.mean(1) * (episode_length / steps)
