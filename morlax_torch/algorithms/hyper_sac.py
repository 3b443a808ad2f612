"""Soft actor-critic for a hypernetwork of policies, which learn from each other's transitions."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.sections import HyperSACOptions
from ..envs import Worlds
from ..gpu.optimizer import ClippedAdam
from ..networks.gaussian import TanhNormal
from ..networks.mlp import smaller
from .off_policy import OffPolicy, Transitions
from .rollout import Explore, Rollout

TYPICAL = 50.0  # root mean square of scaled returns
MAX_NORM = 10.0  # of gradients
TEMPERATURE_RATE = 3e-3  # learning rate


class HyperSAC(OffPolicy):
    """Trains a hypernetwork of actors and one of twin critics from a replay.

    (Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", for vector rewards.)
    Each of an iteration's `method.updates` gradient steps draws K new trade-offs and gives each of
    them transitions of all worlds, whichever trade-off acted there: rewards are stored as vectors,
    so every transition teaches every trade-off. Critics predict one soft value per objective, and
    each sample's target is that of the twin with the smaller weighted value. In short control
    steps, exploration holds its noise for a random number of them, `method.hold` seconds on average
    (after FlashSAC, Kim et al., 2026). It needs `network.type: dual`, and takes the arguments of
    `OffPolicy`.
    """

    losses = ("policy_loss", "value_loss", "entropy", "action_std")
    followed = ("critic",)

    def __init__(self, env: Worlds, config: Config, **others: Any):
        super().__init__(env, config, **others)
        assert isinstance(config.method, HyperSACOptions)
        self.options = config.method
        device, m = env.device, len(env.objectives)
        start = torch.tensor(math.log(self.options.temperature), dtype=torch.float32, device=device)
        self.log_temperature = nn.Parameter(start)
        rate, group = self.options.learning_rate, self.group
        families = self.agent.actor, self.agent.critic
        self.optimizers = (
            *(ClippedAdam([*x.parameters()], rate, MAX_NORM, group=group) for x in families),
            ClippedAdam([self.log_temperature], TEMPERATURE_RATE, math.inf, group=group),
        )
        self._drawn = self.tradeoffs.clone()  # to learn
        self._noise = torch.zeros_like(self.rollout.action[0])  # that explored last
        hold = self.options.hold
        self._repeat = max(0.0, 1 - env.dt / hold) if hold else 0.0  # probability per step
        self._gains = start.new_zeros(env.num_worlds, m)  # discounted, of episodes
        self._process_state |= {"gains": [self._gains], "noise": [self._noise]}
        self._squares = start.new_zeros(m)  # their mean square
        self._seen = start.new_zeros(())  # steps that it is a mean of
        self._state |= {
            "optimizers": [x for optimizer in self.optimizers for x in optimizer.state()],
            "temperature": [self.log_temperature.detach()],
            "scale": [self._squares, self._seen],
        }

    def _start_here(self) -> None:
        super()._start_here()
        self._gains.zero_()

    def _choose(self) -> Explore:
        self._draws.fill(self.tradeoffs, self.generator, self._done)
        actors = self.agent.actors(self.tradeoffs)
        if not self._repeat:
            return actors.explore

        def explore(observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
            draws = torch.empty_like(noise[..., :1]).uniform_(generator=self.generator)
            self._noise.copy_(torch.where(draws < self._repeat, self._noise, noise))
            return actors.explore(observation, self._noise)

        return explore

    def _observe(self, rollout: Rollout) -> None:
        over = (rollout.terminated | rollout.truncated).flatten(1)[..., None]
        for reward, ended in zip(rollout.reward.flatten(1, 2), over, strict=True):
            self._gains.mul_(self.options.discount).add_(reward)
            self._seen += 1
            square = self.group.mean_(self._gains.square().mean(0))
            self._squares.lerp_(square, 1 / self._seen)
            self._gains.masked_fill_(ended, 0.0)

    def _scale(self) -> Tensor:
        """Return divisors of rewards (m,), which scale the returns to about TYPICAL."""
        return (self._squares.sqrt() / TYPICAL).clamp(min=1e-6)

    def _learn(self, rounds: int | None = None) -> None:
        if self.config.decay_fraction:
            decay = self._decay()
            for optimizer in self.optimizers[:2]:
                optimizer.rate.copy_(optimizer.initial_rate * decay)
        super()._learn(rounds)

    def _improve(self) -> None:
        """Take a gradient step of critics, actors and temperature."""
        agent, options, K = self.agent, self.options, len(self.tradeoffs)
        (target,), (actor, critic, tempering) = self.targets, self.optimizers
        scale, temperature = self._scale(), self.log_temperature.detach().exp()
        self._draws.fill(self._drawn, self.generator, self._done)
        weights = self._drawn * scale
        weights = (weights / weights.sum(-1, keepdim=True))[:, None]  # (K, 1, m)
        drawn = self.replay.sample(options.batch, options.steps, options.discount, self.generator)
        rows = Transitions(*(column.view(K, -1, column.shape[-1]) for column in drawn))
        normalized = agent.observation_normalizer
        seen, following = normalized(rows.observation), normalized(rows.following)
        actors, critics = agent.policies(self._drawn), agent.critic(self._drawn)

        def acted(output: Tensor) -> tuple[Tensor, Tensor]:
            policy = TanhNormal(output)
            action = policy.mean + policy.std * policy.noise(self.generator)
            return action.tanh(), policy.log_prob(action)[..., None]

        with torch.no_grad():
            action, log_prob = acted(actors(following).output)
            twins = target.run(target(self._drawn), torch.cat([following, action], -1))
            future = smaller(twins, weights) - temperature * log_prob
            wanted = rows.reward / scale + rows.discount * future
        valued = agent.critic.run(critics, torch.cat([seen, rows.action], -1))
        value_loss = (valued - wanted.repeat(1, 1, 2)).square().mean() * valued.shape[-1]
        critic.step(value_loss)

        policy = actors(seen)
        action, log_prob = acted(policy.output)
        critics = agent.critic(self._drawn)
        twins = agent.critic.run(critics, torch.cat([seen, action], -1))
        value = torch.minimum(*((part * weights).sum(-1, True) for part in twins.chunk(2, -1)))
        policy_loss = (temperature * log_prob - value).mean()
        actor.step(policy_loss)

        with torch.no_grad():
            entropy = -log_prob.mean()
            surplus = entropy - options.entropy * self.env.action_size
            losses = policy_loss, value_loss, entropy, policy.std.mean()
            self._losses += torch.stack([loss.detach() for loss in losses])
        self._follow(options.target_rate)
        tempering.step(self.log_temperature.exp() * surplus)

    def _means(self) -> dict[str, Tensor]:
        return {**super()._means(), "temperature": self.log_temperature.detach().exp()}
