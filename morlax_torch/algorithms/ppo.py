"""The clipped policy objective and the value loss, for a whole family at once."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ..config_sections import PPOConfig
from ..gpu.graph import Branch
from ..gpu.group import ALONE, Group
from ..gpu.optimizer import ClippedAdam
from ..networks.agent import Agent
from ..networks.gaussian import TanhNormal
from .rollout import Rollout, advantages

RATE_STEP, RATES = 1.5, (1e-6, 1e-2)  # factor and bounds of an adaptive learning rate


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
    tradeoffs: Tensor,
    rollout: Rollout,
    config: PPOConfig,
    weights: Tensor,
    group: Group = ALONE,
) -> tuple[Batch, Tensor]:
    """Estimate what to learn from a rollout; statistics are those of all processes of the group.

    Args:
        agent: that acted.
        tradeoffs: (K, m)
        rollout: of K clusters.
        config: of the updates.
        weights: (K, m) of each objective's advantage; a scalar critic weighs rewards by the
            trade-offs instead.
        group: processes over which statistics are taken.

    Returns:
        A batch by world, (K, G, T, ...) each, and the explained variance per value of the critic,
        (m,) or (1,), 0 where targets do not vary.
    """
    values = agent.values(tradeoffs)
    if config.critic == "scalar":
        weighted = rollout.reward * tradeoffs[:, None]
        rollout = rollout._replace(reward=weighted.sum(-1, keepdim=True))

    def value_of(observation: Tensor) -> Tensor:  # (T, K, G, O + P) -> (T, K, G, m)
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
    spread = target.var((0, 1, 2))
    explained = torch.where(spread > 0, 1 - advantage.var((0, 1, 2)) / spread, 0.0)
    if config.normalize_values:
        agent.value_normalizer.update(target, group=group)
        target = agent.value_normalizer(target)
    if config.critic == "vector":
        advantage = advantage * weights[:, None]
    scalar = advantage.sum(-1)  # (T, K, G)
    together = (0, 2) if config.normalize_advantages == "cluster" else (0, 1, 2)
    variance, mean = torch.var_mean(scalar, together, correction=0, keepdim=True)
    mean, variance = group.moments(mean, variance)
    number = group.size * scalar.numel() // mean.numel()
    scalar = (scalar - mean) / ((variance * number / max(number - 1, 1)).sqrt() + 1e-8)
    batch = Batch(
        seen, rollout.action, rollout.log_prob.unsqueeze(-1), scalar.unsqueeze(-1), target
    )
    return Batch(*(column.permute(1, 2, 0, 3) for column in batch)), explained


class Table:
    """A batch as one table, so that shuffling is one gather.

    Args:
        batch: by world, (K, G, T, ...) each.
    """

    def __init__(self, batch: Batch):
        self._widths = [column.shape[-1] for column in batch]
        self._dense = batch.log_prob.shape[1] == 1
        packed = torch.cat(batch, -1)
        self._rows = packed.transpose(0, 1) if self._dense else packed
        self._firsts = torch.arange(len(self._rows), device=packed.device)[:, None]

    def minibatches(
        self, tradeoffs: Tensor, number: int, generator: torch.Generator
    ) -> list[tuple[Tensor, Batch]]:
        """Deal the table out to the minibatches of one epoch.

        Worlds are shuffled within their clusters and dealt out, so that every minibatch holds all
        clusters and generates each cluster's parameters once. If every world has its own trade-off,
        whole clusters are dealt out instead.

        Returns:
            The trade-offs (K, m) and samples (K, S, ...) of each minibatch.
        """
        draws = self._rows.new_empty(self._rows.shape[:2]).uniform_(generator=generator)
        order = draws.argsort(1)
        dealt = []
        for part, chosen in zip(
            self._rows[self._firsts, order].chunk(number, 1), order.chunk(number, 1), strict=True
        ):
            part = part.transpose(0, 1) if self._dense else part
            own = tradeoffs[chosen[0]] if self._dense else tradeoffs
            dealt.append((own, Batch(*part.flatten(1, 2).split(self._widths, -1))))
        return dealt


def policy_loss(
    output: Tensor,
    action: Tensor,
    noise: Tensor,
    old_log_prob: Tensor,
    advantage: Tensor,
    clip: float,
    mean_penalty: float,
    entropy_weight: Tensor,
) -> tuple[Tensor, Tensor]:
    """Compute PPO's clipped surrogate minus the entropy bonus plus the penalty on large means.

    (Schulman et al., 2017, eq. 7 and 9. The KL from the policy that acted to the current one uses
    the estimator E[r - 1 - log r].) On CUDA, `gpu.loss_kernels.policy_loss` does the same in two
    kernels.

    Args:
        output: of the actors, (K, S, 2A).
        action: before the tanh, (K, S, A).
        noise: standard normal, (K, S, A), to estimate the entropy.
        old_log_prob: (K, S, 1) under the policy that acted.
        advantage: (K, S, 1) scalarized.
        clip: largest change of the probability ratio that counts.
        mean_penalty: weight of the squared means.
        entropy_weight: (), a tensor so that a recorded graph can anneal it.

    Returns:
        The loss (), and without gradients (5,): the surrogate, the entropy, the KL, the clipped
        share, and the mean standard deviation of actions before the tanh.
    """
    policy = TanhNormal(output)
    log_ratio = policy.log_prob(action) - old_log_prob.squeeze(-1)
    ratio, gain = log_ratio.exp(), advantage.squeeze(-1)
    clipped = ratio.clamp(1 - clip, 1 + clip)
    surrogate = -torch.minimum(ratio * gain, clipped * gain).mean()
    entropy = policy.entropy(noise).mean()
    loss = surrogate - entropy_weight * entropy
    if mean_penalty:
        loss = loss + mean_penalty * policy.mean.square().sum(-1).mean()
    with torch.no_grad():
        kl = (ratio - 1 - log_ratio).mean()
        clip_fraction = (ratio != clipped).float().mean()
        found = torch.stack([surrogate, entropy, kl, clip_fraction, policy.std.mean()])
    return loss, found


def value_loss(value: Tensor, target: Tensor, coefficient: float) -> Tensor:
    """Compute the squared error of the vector value, summed over objectives: ().

    On CUDA, `gpu.loss_kernels.value_loss` does the same in two kernels.

    Args:
        value: (K, S, m)
        target: (K, S, m)
        coefficient: of the loss.
    """
    return coefficient * (value - target).square().sum(-1).mean()


class Losses(NamedTuple):
    """The losses, or fused kernels for them."""

    policy: Callable[..., tuple[Tensor, Tensor]] = policy_loss
    value: Callable[[Tensor, Tensor, float], Tensor] = value_loss


class PPO:
    """Updates an agent's families; actor and critic have separate losses and optimizers.

    The two share nothing, so on CUDA their updates run in parallel. A `joint` optimizer is one for
    the sum of the losses. A `single` hypernetwork shares its features between both, and so always
    has that.

    Args:
        agent: updated in place.
        config: of the updates.
        losses: of policy and value (None: their torch definitions).
        group: processes that update equal agents together.
    """

    metrics = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction", "action_std")

    def __init__(
        self,
        agent: Agent,
        config: PPOConfig,
        losses: Losses | None = None,
        group: Group = ALONE,
    ):
        self.agent, self.config, self._losses = agent, config, losses or Losses()
        self._group = group
        actor, critic = list(agent.actor.parameters()), list(agent.critic.parameters())
        self.rates = (config.learning_rate, config.critic_learning_rate or config.learning_rate)
        norm = config.max_grad_norm
        shared = bool({*map(id, actor)} & {*map(id, critic)})
        self.joint = shared or config.optimizer == "joint"
        groups = [list(dict.fromkeys(actor + critic))] if self.joint else [actor, critic]
        self.optimizers = [
            ClippedAdam(own, rate, norm, agent.num_networks, channel)
            for own, rate, channel in zip(
                groups, self.rates, (group, group.channel()), strict=False
            )
        ]
        self.optimizer_names = ("joint",) if self.joint else ("actor", "critic")
        self.entropy = actor[0].new_tensor(config.entropy)
        self.desired_kl = actor[0].new_tensor(config.desired_kl or 0.0)
        self._branch = Branch(actor[0].device)

    def state(self) -> list[Tensor]:
        """Return every tensor of the optimizers, in a fixed order; all are updated in place."""
        return [
            *(value for optimizer in self.optimizers for value in optimizer.state()),
            self.entropy,
        ]

    def restore(self, state: Sequence[Tensor]) -> None:
        """Load what `state` returned, in place, also on another device."""
        *moments, entropy = state
        size = len(moments) // len(self.optimizers)
        for i, optimizer in enumerate(self.optimizers):
            optimizer.restore(moments[i * size : (i + 1) * size])
        self.entropy.copy_(entropy)

    def improve(self, parts: list[tuple[Tensor, Batch]], generator: torch.Generator) -> Tensor:
        """Take an optimizer step on every minibatch; returns the means of `metrics`, (6,)."""
        policies, values = [], []
        shapes = [batch.action.shape for _, batch in parts]
        drawn = self.entropy.new_empty(sum(shape.numel() for shape in shapes))
        drawn = drawn.normal_(generator=generator).split([shape.numel() for shape in shapes])
        noises = [noise.view(shape) for noise, shape in zip(drawn, shapes, strict=True)]
        if self.joint:
            for (tradeoffs, batch), noise in zip(parts, noises, strict=True):
                policy_loss, found = self.policy_loss(tradeoffs, batch, noise)
                value_loss = self.value_loss(tradeoffs, batch)
                self._adapt(found)
                self.optimizers[0].step(policy_loss + value_loss)
                policies.append(found)
                values.append(value_loss.detach())
        else:
            actor, critic = self.optimizers
            with self._branch:
                for tradeoffs, batch in parts:
                    value_loss = self.value_loss(tradeoffs, batch)
                    critic.step(value_loss)
                    values.append(value_loss.detach())
            for (tradeoffs, batch), noise in zip(parts, noises, strict=True):
                policy_loss, found = self.policy_loss(tradeoffs, batch, noise)
                self._adapt(found)
                actor.step(policy_loss)
                policies.append(found)
            self._branch.join()
        policy = torch.stack(policies).mean(0)
        return torch.cat([policy[:1], torch.stack(values).mean(0, keepdim=True), policy[1:]])

    def policy_loss(self, tradeoffs: Tensor, batch: Batch, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Compute `policy_loss` of the current actors on a minibatch with noise (K, S, A)."""
        policy = self.agent.policies(tradeoffs)(batch.observation)
        return self._losses.policy(
            policy.output,
            batch.action,
            noise,
            batch.log_prob,
            batch.advantage,
            self.config.clip,
            self.config.mean_penalty,
            self.entropy,
        )

    def value_loss(self, tradeoffs: Tensor, batch: Batch) -> Tensor:
        """Compute `value_loss` of the current critics on a minibatch."""
        value = self.agent.values(tradeoffs)(batch.observation)
        return self._losses.value(value, batch.target, self.config.value_coefficient)

    def _adapt(self, found: Tensor) -> None:
        """Change the actor's learning rate towards `desired_kl`, as rsl_rl's adaptive schedule."""
        if self.config.desired_kl is None:
            return
        kl, rate = self._group.mean_(found[2].clone()), self.optimizers[0].rate
        factor = torch.where(kl < self.desired_kl / 2, RATE_STEP, 1.0)
        factor = torch.where(kl > self.desired_kl * 2, 1 / RATE_STEP, factor)
        rate.mul_(factor).clamp_(*RATES)

    def anneal(self, left: Tensor) -> None:
        """Scale what decays by the share of the run that is `left`."""
        for optimizer, rate in zip(self.optimizers, self.rates, strict=False):
            if self.config.desired_kl is None or optimizer is not self.optimizers[0]:
                optimizer.rate.copy_(rate * left)
        self.desired_kl.copy_((self.config.desired_kl or 0.0) * left)
        self.entropy.copy_(self.config.entropy * left)
