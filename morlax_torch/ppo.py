"""The clipped policy objective and the value loss, for a whole family at once."""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor, nn

from .agent import Agent
from .config import PPOConfig
from .rollout import Rollout, advantages


class Batch(NamedTuple):
    """S samples of each of K trade-offs."""

    observation: Tensor  # (K, S, O) normalised
    action: Tensor  # (K, S, A) before the tanh
    log_prob: Tensor  # (K, S, 1) when it was taken
    advantage: Tensor  # (K, S, 1) scalarised by the trade-off
    target: Tensor  # (K, S, m) what the critic should say


class Losses(NamedTuple):
    """What one minibatch says of the update; scalars."""

    policy_loss: Tensor
    value_loss: Tensor
    entropy: Tensor
    kl: Tensor  # from the policy that acted to the present one
    clip_fraction: Tensor


@torch.no_grad()
def judge(
    agent: Agent, tradeoffs: Tensor, rollout: Rollout, config: PPOConfig
) -> tuple[Batch, Tensor]:
    """What to learn from a rollout, by world (K, G, T, ...), and explained variances (m,)."""
    values = agent.values(tradeoffs)

    def value_of(observation: Tensor) -> Tensor:  # (T, K, G, O) -> (T, K, G, m)
        rows = observation.transpose(0, 1).flatten(1, 2)
        value = values(rows).unflatten(1, (len(observation), -1)).transpose(0, 1)
        return agent.value_normalizer.inverse(value) if config.normalize_values else value

    seen = agent.observation_normalizer(rollout.observation)
    value = value_of(seen)
    final_value = value_of(agent.observation_normalizer(rollout.final_observation))
    advantage = advantages(
        rollout,
        value,
        final_value,
        config.discount,
        config.gae_lambda,
        config.truncation == "bootstrap",
    )
    target = advantage + value
    explained = 1 - advantage.var((0, 1, 2)) / target.var((0, 1, 2))
    if config.normalize_values:
        agent.value_normalizer.update(target)
        target = agent.value_normalizer(target)
    scalar = (advantage * tradeoffs[:, None]).sum(-1)
    scalar = (scalar - scalar.mean()) / (scalar.std() + 1e-8)
    batch = Batch(
        seen, rollout.action, rollout.log_prob.unsqueeze(-1), scalar.unsqueeze(-1), target
    )
    return Batch(*(column.permute(1, 2, 0, 3) for column in batch)), explained


def minibatches(
    batch: Batch, tradeoffs: Tensor, config: PPOConfig, generator: torch.Generator
) -> Iterator[tuple[Tensor, Batch]]:
    """Trade-offs and samples of each minibatch of each epoch.

    Every epoch shuffles the worlds within their clusters and deals them out, so that a minibatch
    holds all clusters and generates each cluster's parameters once. Where every world has a
    trade-off of its own, whole clusters are dealt out instead.
    """
    widths = [column.shape[-1] for column in batch]
    packed = torch.cat(batch, -1)  # one table, so that shuffling is one gather
    if packed.shape[1] == 1:
        packed = packed.transpose(0, 1)
    rows = torch.arange(len(packed), device=packed.device)[:, None]
    for _ in range(config.epochs):
        draws = torch.empty(packed.shape[:2], device=packed.device).uniform_(generator=generator)
        order = draws.argsort(1)
        shuffled = packed[rows, order]
        for part, chosen in zip(
            shuffled.chunk(config.minibatches, 1), order.chunk(config.minibatches, 1), strict=True
        ):
            if batch.log_prob.shape[1] == 1:
                own, part = tradeoffs[chosen[0]], part.transpose(0, 1)
            else:
                own = tradeoffs
            yield own, Batch(*part.flatten(1, 2).split(widths, -1))


class PPO:
    """Moves the hypernetworks of an agent; actor and critic have separate losses and optimisers.

    A `single` hypernetwork shares its features between both, and so its optimiser.
    """

    def __init__(self, agent: Agent, config: PPOConfig):
        self.agent, self.config = agent, config
        actor, critic = list(agent.actor.parameters()), list(agent.critic.parameters())
        rates = [config.learning_rate, config.critic_learning_rate or config.learning_rate]
        if agent.actor.features is agent.critic.features:
            self.groups, rates = [list(dict.fromkeys(actor + critic))], rates[:1]
        else:
            self.groups = [actor, critic]
        on_gpu = actor[0].is_cuda
        self.optimizers = [
            torch.optim.Adam(group, rate, fused=True, capturable=on_gpu)
            for group, rate in zip(self.groups, rates, strict=True)
        ]
        for optimizer, group in zip(self.optimizers, self.groups, strict=True):
            # Let gradients and moments exist from the start, so that they are only ever written
            # in place: a recorded graph knows them by their addresses.
            for parameter in group:
                parameter.grad = torch.zeros_like(parameter)
            optimizer.step()
        for tensor in self.state():
            tensor.zero_()

    def state(self) -> list[Tensor]:
        """Every tensor of the optimisers, in a fixed order; written in place only."""
        return [
            value
            for optimizer in self.optimizers
            for parameter in optimizer.param_groups[0]["params"]
            for _, value in sorted(optimizer.state[parameter].items())
        ]

    def improve(self, tradeoffs: Tensor, batch: Batch, generator: torch.Generator) -> Losses:
        """One step of both optimisers on one minibatch."""
        losses = self.losses(tradeoffs, batch, generator)
        (losses.policy_loss - self.config.entropy * losses.entropy + losses.value_loss).backward()
        for group, optimizer in zip(self.groups, self.optimizers, strict=True):
            nn.utils.clip_grad_norm_(group, self.config.max_grad_norm)
            optimizer.step()
            optimizer.zero_grad(set_to_none=False)
        return losses

    def losses(self, tradeoffs: Tensor, batch: Batch, generator: torch.Generator) -> Losses:
        policy = self.agent.policies(tradeoffs)(batch.observation)
        log_ratio = policy.log_prob(batch.action) - batch.log_prob.squeeze(-1)
        ratio, advantage = log_ratio.exp(), batch.advantage.squeeze(-1)
        clipped = ratio.clamp(1 - self.config.clip, 1 + self.config.clip)
        error = self.agent.values(tradeoffs)(batch.observation) - batch.target
        return Losses(
            policy_loss=-torch.minimum(ratio * advantage, clipped * advantage).mean(),
            value_loss=self.config.value_coefficient * error.square().sum(-1).mean(),
            entropy=policy.entropy(generator).mean(),
            kl=(ratio.detach() - 1 - log_ratio.detach()).mean(),
            clip_fraction=(ratio.detach() != clipped.detach()).float().mean(),
        )
