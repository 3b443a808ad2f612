"""The clipped policy objective and the value loss, for a whole family at once."""

from typing import NamedTuple

import torch
from torch import Tensor

from . import fused
from .agent import Agent
from .config import PPOConfig
from .graph import Beside
from .optimizer import ClippedAdam
from .rollout import Rollout, advantages


class Batch(NamedTuple):
    """S samples of each of K trade-offs."""

    observation: Tensor  # (K, S, O + P) normalised
    action: Tensor  # (K, S, A) before the tanh
    log_prob: Tensor  # (K, S, 1) when it was taken
    advantage: Tensor  # (K, S, 1) scalarised by the trade-off
    target: Tensor  # (K, S, m) what the critic should say


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
    batch: Batch, tradeoffs: Tensor, number: int, generator: torch.Generator
) -> list[tuple[Tensor, Batch]]:
    """The minibatches of one epoch: their trade-offs, and their samples (K, S, ...).

    Worlds are shuffled within their clusters and dealt out, so that a minibatch holds all
    clusters and generates each cluster's parameters once. Where every world has a trade-off of
    its own, whole clusters are dealt out instead.
    """
    widths = [column.shape[-1] for column in batch]
    dense = batch.log_prob.shape[1] == 1
    packed = torch.cat(batch, -1)  # (K, G, T, ...): one table, so that shuffling is one gather
    packed = packed.transpose(0, 1) if dense else packed
    rows = torch.arange(len(packed), device=packed.device)[:, None]
    draws = torch.empty(packed.shape[:2], device=packed.device).uniform_(generator=generator)
    order = draws.argsort(1)
    dealt = []
    for part, chosen in zip(
        packed[rows, order].chunk(number, 1), order.chunk(number, 1), strict=True
    ):
        part = part.transpose(0, 1) if dense else part
        own = tradeoffs[chosen[0]] if dense else tradeoffs
        dealt.append((own, Batch(*part.flatten(1, 2).split(widths, -1))))
    return dealt


class PPO:
    """Moves the hypernetworks of an agent; actor and critic have separate losses and optimisers.

    They share nothing, so on CUDA their updates run side by side. A `single` hypernetwork shares
    its features between both, and so has one optimiser for the sum of the losses.
    """

    metrics = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction")

    def __init__(self, agent: Agent, config: PPOConfig):
        self.agent, self.config = agent, config
        actor, critic = list(agent.actor.parameters()), list(agent.critic.parameters())
        self.rates = (config.learning_rate, config.critic_learning_rate or config.learning_rate)
        norm = config.max_grad_norm
        self.single = agent.actor.features is agent.critic.features
        if self.single:
            self.optimizers = [
                ClippedAdam(list(dict.fromkeys(actor + critic)), self.rates[0], norm)
            ]
        else:
            self.optimizers = [
                ClippedAdam(group, rate, norm)
                for group, rate in zip((actor, critic), self.rates, strict=True)
            ]
        self.entropy = actor[0].new_tensor(config.entropy)
        self._beside = Beside(actor[0].device)

    def state(self) -> list[Tensor]:
        """Every tensor of the optimisers, in a fixed order; written in place only."""
        return [
            *(value for optimizer in self.optimizers for value in optimizer.state()),
            self.entropy,
        ]

    def improve(self, parts: list[tuple[Tensor, Batch]], generator: torch.Generator) -> Tensor:
        """A step on every minibatch; the means of `metrics` over them, (5,)."""
        policies, values = [], []
        if self.single:
            for tradeoffs, batch in parts:
                policy_loss, found = self.policy_loss(tradeoffs, batch, generator)
                value_loss = self.value_loss(tradeoffs, batch)
                self.optimizers[0].step(policy_loss + value_loss)
                policies.append(found)
                values.append(value_loss.detach())
        else:
            actor, critic = self.optimizers
            with self._beside:
                for tradeoffs, batch in parts:
                    value_loss = self.value_loss(tradeoffs, batch)
                    critic.step(value_loss)
                    values.append(value_loss.detach())
            for tradeoffs, batch in parts:
                policy_loss, found = self.policy_loss(tradeoffs, batch, generator)
                actor.step(policy_loss)
                policies.append(found)
            self._beside.join()
        policy = torch.stack(policies).mean(0)
        return torch.cat([policy[:1], torch.stack(values).mean(0, keepdim=True), policy[1:]])

    def policy_loss(
        self, tradeoffs: Tensor, batch: Batch, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """The clipped surrogate, less the entropy bonus, plus the penalty of far means.

        Beside it the surrogate alone, the entropy, the KL and the share clipped, (4,). (Schulman
        et al., 2017, eq. 7 and 9; KL from the policy that acted to the present one, by the
        estimator E[r - 1 - log r].)
        """
        policy = self.agent.policies(tradeoffs)(batch.observation)
        clip, bonus, penalty = self.config.clip, self.entropy, self.config.mean_penalty
        noise = policy.noise(generator)
        if policy.output.is_cuda:
            given = (batch.action, noise, batch.log_prob, batch.advantage)
            return fused.PolicyLoss.apply(policy.output, *given, clip, penalty, bonus)
        log_ratio = policy.log_prob(batch.action) - batch.log_prob.squeeze(-1)
        ratio, advantage = log_ratio.exp(), batch.advantage.squeeze(-1)
        clipped = ratio.clamp(1 - clip, 1 + clip)
        surrogate = -torch.minimum(ratio * advantage, clipped * advantage).mean()
        entropy = policy.entropy(noise).mean()
        loss = surrogate - bonus * entropy
        if penalty:
            loss = loss + penalty * policy.mean.square().sum(-1).mean()
        with torch.no_grad():
            kl = (ratio - 1 - log_ratio).mean()
            clip_fraction = (ratio != clipped).float().mean()
            found = torch.stack([surrogate, entropy, kl, clip_fraction])
        return loss, found

    def value_loss(self, tradeoffs: Tensor, batch: Batch) -> Tensor:
        """The squared error of the vector value, summed over objectives."""
        error = self.agent.values(tradeoffs)(batch.observation) - batch.target
        return self.config.value_coefficient * error.square().sum(-1).mean()

    def anneal(self, left: Tensor) -> None:
        """Scale step sizes and the entropy's weight to the share of the run that is `left`."""
        for optimizer, rate in zip(self.optimizers, self.rates, strict=False):
            optimizer.rate.copy_(rate * left)
        self.entropy.copy_(self.config.entropy * left)
