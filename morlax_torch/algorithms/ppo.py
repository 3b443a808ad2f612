"""The clipped policy objective and the value loss, for a whole family at once."""

import torch
from torch import Tensor

from ..configuration.sections import PPOConfig
from ..gpu import fused
from ..gpu.graph import Branch
from ..gpu.group import ALONE, Group
from ..gpu.optimizer import ClippedAdam
from ..networks.agent import Agent
from ..networks.gaussian import TanhNormal
from .batch import Batch

RATE_STEP, RATES = 1.5, (1e-7, 1e-2)  # factor and bounds of an adaptive learning rate


def policy_loss(
    output: Tensor,  # (K, S, 2A) of the actors
    action: Tensor,  # (K, S, A) before the tanh
    noise: Tensor,  # (K, S, A) standard normal, to estimate the entropy
    old_log_prob: Tensor,  # (K, S, 1) under the policy that acted
    advantage: Tensor,  # (K, S, 1) scalarized
    clip: float,  # largest change of the probability ratio that counts
    mean_penalty: float,  # weight of the squared means
    entropy_weight: Tensor,  # () a tensor so that a recorded graph can decay it
) -> tuple[Tensor, Tensor]:
    """Compute PPO's clipped surrogate minus the entropy bonus plus the penalty on large means.

    (Schulman et al., 2017, eq. 7 and 9. The KL from the policy that acted to the current one uses
    the estimator E[r - 1 - log r].)

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
        parts = torch.stack([surrogate, entropy, kl, clip_fraction, policy.std.mean()])
    return loss, parts


class PPO:
    """Updates an agent's families; actor and critic have separate losses and optimizers.

    The two share nothing, so on CUDA their updates run in parallel. A `joint` optimizer is one for
    the sum of the losses. A `single` hypernetwork shares its features between both, and so always
    has that. The processes of a `group` update equal agents together.
    """

    metrics = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction", "action_std")

    def __init__(self, agent: Agent, config: PPOConfig, group: Group = ALONE):
        self.agent, self.config, self._group = agent, config, group
        actor, critic = list(agent.actor.parameters()), list(agent.critic.parameters())
        rate, norm, networks = config.learning_rate, config.max_grad_norm, agent.num_networks
        together = list(dict.fromkeys(actor + critic))
        self.joint = len(together) < len(actor + critic) or config.optimizer == "joint"
        if self.joint:
            self.optimizers = [ClippedAdam(together, rate, norm, networks, group)]
        else:
            critic_rate = config.critic_learning_rate or rate
            self.optimizers = [
                ClippedAdam(actor, rate, norm, networks, group),
                ClippedAdam(critic, critic_rate, norm, networks, group.channel),
            ]
        self.entropy = actor[0].new_tensor(config.entropy)
        self.desired_kl = actor[0].new_tensor(config.desired_kl or 0.0)
        self._branch = Branch(actor[0].device)
        kernels = fused.kernels(actor[0].device)
        self._policy_loss = kernels.policy_loss if kernels else policy_loss

    def state(self) -> list[Tensor]:
        """Return every tensor of the optimizers, in a fixed order; all are updated in place."""
        return [*(x for optimizer in self.optimizers for x in optimizer.state()), self.entropy]

    def improve(
        self,
        parts: list[tuple[Tensor, Batch]],
        generator: torch.Generator,
        first: bool = True,
        last: bool = True,
    ) -> Tensor:
        """Take an optimizer step on every minibatch of an epoch; return means of `metrics`, (6,).

        The parts are conditions with minibatches. The epoch may be the `first` or the `last` one on
        a rollout.
        """
        policies, values = [], []
        action = parts[0][1].action
        # in one kernel, to estimate entropies
        noises = action.new_empty(len(parts), *action.shape).normal_(generator=generator)
        if not self.joint:
            with self._branch:
                for conditions, batch in parts:
                    value_loss = self.value_loss(conditions, batch)
                    self.optimizers[1].step(value_loss)
                    values.append(value_loss.detach())
        for (conditions, batch), noise in zip(parts, noises, strict=True):
            loss, means = self.policy_loss(conditions, batch, noise)
            if self.joint:
                value_loss = self.value_loss(conditions, batch)
                values.append(value_loss.detach())
                loss = loss + value_loss
            if policies or not first:
                self._adapt(means)
            self.optimizers[0].step(loss)
            policies.append(means)
        if not self.joint:
            self._branch.join()
        if last and self.config.desired_kl is not None:
            with torch.no_grad():
                self._adapt(self.policy_loss(*parts[-1], noises[-1])[1])
        policy = torch.stack(policies).mean(0)
        return torch.cat([policy[:1], torch.stack(values).mean(0, keepdim=True), policy[1:]])

    def policy_loss(self, conditions: Tensor, batch: Batch, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Compute `policy_loss` of the current actors on a minibatch with noise (K, S, A)."""
        policy = self.agent.policies(conditions)(batch.observation)
        return self._policy_loss(
            policy.output,
            batch.action,
            noise,
            batch.log_prob,
            batch.advantage,
            self.config.clip,
            self.config.mean_penalty,
            self.entropy,
        )

    def value_loss(self, conditions: Tensor, batch: Batch) -> Tensor:
        """Compute the squared error of the current critics, summed over objectives."""
        value = self.agent.values(conditions)(batch.observation)
        error = (value - batch.target).square().sum(-1).mean()
        return self.config.value_coefficient * error

    def _adapt(self, metrics: Tensor) -> None:
        """Change the actor's learning rate towards `desired_kl`, as rsl_rl's adaptive schedule.

        The first minibatch of a rollout is left out: before any step its KL is zero. Each later one
        shows the KL after the previous step; the last is evaluated once more after its own step.
        """
        if self.config.desired_kl is None:
            return
        kl, rate = self._group.mean_(metrics[2].clone()), self.optimizers[0].rate
        factor = torch.where(kl < self.desired_kl / 2, RATE_STEP, 1.0)
        factor = torch.where(kl > self.desired_kl * 2, 1 / RATE_STEP, factor)
        rate.mul_(factor.to(rate)).clamp_(*RATES)

    def decay(self, factor: Tensor) -> None:
        """Scale learning rates, desired KL and entropy bonus of the config by a `factor` ()."""
        for optimizer in self.optimizers:
            if self.config.desired_kl is None or optimizer is not self.optimizers[0]:
                optimizer.rate.copy_(optimizer.initial_rate * factor)
        self.desired_kl.copy_((self.config.desired_kl or 0.0) * factor)
        self.entropy.copy_(self.config.entropy * factor)
