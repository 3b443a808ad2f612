"""What PPO learns from: a rollout's samples with their advantages and targets, in minibatches."""

from typing import NamedTuple

import torch
from torch import Tensor

from ..configuration.sections import PPOConfig
from ..gpu.group import ALONE, Group
from ..networks.agent import Agent
from .rollout import Rollout, advantages


class Batch(NamedTuple):
    """S samples of each of K trade-offs."""

    observation: Tensor  # (K, S, O + P) normalized
    action: Tensor  # (K, S, A) before the tanh
    log_prob: Tensor  # (K, S, 1) under the policy that acted
    advantage: Tensor  # (K, S, 1) scalarized by the trade-off
    target: Tensor  # (K, S, m) of the critic, or (K, S, 1)


@torch.no_grad()
def make_batch(
    agent: Agent,
    conditions: Tensor,
    rollout: Rollout,
    config: PPOConfig,
    weights: Tensor,
    group: Group = ALONE,
) -> tuple[Batch, Tensor]:
    """Estimate what to learn from a rollout of K clusters; statistics are those of all processes.

    Those of a cluster are of this process alone, since others have other trade-offs. The advantage
    of each objective is weighted by `weights` (K, m). A scalar critic weighs rewards by the
    trade-offs of the conditions (K, m + d) instead.

    Returns:
        A batch by world, (K, G, T, ...) each, and the explained variance per value of the critic,
        (m,) or (1,), 0 where targets do not vary.
    """
    values = agent.values(conditions)
    if config.critic == "scalar":
        weighted = rollout.reward * conditions[:, None, : rollout.reward.shape[-1]]
        rollout = rollout._replace(reward=weighted.sum(-1, keepdim=True))

    def value_of(observation: Tensor) -> Tensor:  # (T, K, G, O + P) -> (T, K, G, m)
        rows = observation.transpose(0, 1).flatten(1, 2)
        value = values(rows).unflatten(1, (len(observation), -1)).transpose(0, 1)
        return agent.value_normalizer.inverse(value)

    seen = agent.observation_normalizer(rollout.observation)
    value = value_of(seen)
    final_value = value_of(agent.observation_normalizer(rollout.final_observation))
    advantage = advantages(rollout, value, final_value, config)
    target = advantage + value
    spread = target.var((0, 1, 2))
    explained = torch.where(spread > 0, 1 - advantage.var((0, 1, 2)) / spread, 0.0)
    agent.value_normalizer.update(target, group=group)
    target = agent.value_normalizer(target)
    if config.critic == "vector":
        advantage = advantage * weights[:, None]
    scalar = advantage.sum(-1)  # (T, K, G)
    together = (0, 1, 2)
    if config.normalize_advantages == "cluster":
        together, group = (0, 2), ALONE
    variance, mean = torch.var_mean(scalar, together, correction=0, keepdim=True)
    mean, variance = group.moments(mean, variance)
    number = group.size * scalar.numel() // mean.numel()
    # moments of several processes can only be merged if biased: the factor undoes that
    scalar = (scalar - mean) / ((variance * number / max(number - 1, 1)).sqrt() + 1e-8)
    columns = seen, rollout.action, rollout.log_prob[..., None], scalar[..., None], target
    return Batch(*(column.permute(1, 2, 0, 3) for column in columns)), explained


class Table:
    """A batch by world, (K, G, T, ...) each, as one table, so that shuffling is one gather."""

    def __init__(self, batch: Batch):
        self._widths = [column.shape[-1] for column in batch]
        self._dense = batch.log_prob.shape[1] == 1
        packed = torch.cat(batch, -1)
        self._rows = packed.transpose(0, 1) if self._dense else packed
        self._firsts = torch.arange(len(self._rows), device=packed.device)[:, None]

    def minibatches(
        self, conditions: Tensor, number: int, generator: torch.Generator
    ) -> list[tuple[Tensor, Batch]]:
        """Deal out conditions (K, m + d) and samples (K, S, ...) to the minibatches of an epoch.

        Worlds are shuffled within their clusters and dealt out, so that every minibatch holds all
        clusters and generates each cluster's parameters once. If every world has its own trade-off,
        whole clusters are dealt out instead.
        """
        draws = self._rows.new_empty(self._rows.shape[:2]).uniform_(generator=generator)
        order = draws.argsort(1)
        dealt, parts = [], self._rows[self._firsts, order].chunk(number, 1)
        for part, chosen in zip(parts, order.chunk(number, 1), strict=True):
            part = part.transpose(0, 1) if self._dense else part
            chosen_conditions = conditions[chosen[0]] if self._dense else conditions
            dealt.append((chosen_conditions, Batch(*part.flatten(1, 2).split(self._widths, -1))))
        return dealt


@torch.no_grad()
def expected_returns(
    agent: Agent,
    conditions: Tensor,
    starts: Tensor,
    failing: Tensor,
    discount: float,
    episode_length: int,
) -> Tensor:
    """Estimate the undiscounted returns (K, m) of whole episodes.

    A discounted value V of T steps with the same reward is (1 - gamma^T) / (1 - gamma) times that
    reward, and the undiscounted return is T times. So V, which the agent's critics estimate at the
    `starts` (K, S, O + P) of episodes under conditions (K, m + d), is scaled by the ratio of both.
    Critics look beyond the time limit, which a share of gamma^T comes from if policies last so
    long: (1 - f)^T of them do, of which shares f = `failing` (K,) of all steps fail.
    """
    value = agent.values(conditions)(agent.observation_normalizer(starts))
    value = agent.value_normalizer.inverse(value)
    if discount == 1:  # the value beyond is infinite
        return value.mean(1)
    steps = (1 - discount**episode_length) / (1 - discount)
    within = 1 - (discount * (1 - failing)) ** episode_length
    return value.mean(1) * within[:, None] * (episode_length / steps)
