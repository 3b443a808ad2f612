"""Soft actor-critic for a hypernetwork of policies, which learn from each other's transitions."""

import copy
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ..configuration.sections import HyperSACOptions
from ..envs import MorlaxError, Worlds
from ..gpu.optimizer import ClippedAdam
from ..host.resources import memory_of, one_thread
from ..networks.gaussian import TanhNormal
from ..networks.mlp import smaller
from .learner import Learner
from .rollout import Explore, Rollout, collect

MOST = 0.5  # share of the memory that a replay may take
TYPICAL = 50.0  # root mean square of scaled returns
MAX_NORM = 10.0  # of gradients
TEMPERATURE_RATE = 3e-3  # learning rate
METRICS = "policy_loss", "value_loss", "entropy", "action_std"  # means over gradient steps


class Transitions(NamedTuple):
    """S steps, or stretches of a few, in any worlds."""

    observation: Tensor  # (S, O + P) raw, as critics see it
    action: Tensor  # (S, A) in (-1, 1)
    reward: Tensor  # (S, m) discounted sum over the stretch
    following: Tensor  # (S, O + P) raw, after the stretch and before any reset
    discount: Tensor  # (S, 1) of the value of `following`: 0 if the episode terminated there


class Replay:
    """A ring of the last R = `capacity` steps of N worlds, on their device.

    Nothing waits for the GPU, so storing and sampling can be recorded.
    """

    def __init__(self, capacity: int, env: Worlds):
        features, number = env.observation_size + env.privileged_size, capacity * env.num_worlds
        size = 4 * (2 * features + env.action_size + len(env.objectives)) + 2  # bytes of each
        most = MOST * memory_of(env.device)
        if number * size > most:
            raise MorlaxError(
                f"a replay of {number:,} transitions takes {number * size / 2**30:.1f} GiB, more "
                f"than {MOST:.0%} of the memory of {env.device}: "
                f"try --method.replay {int(most / size)}."
            )

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(capacity, env.num_worlds, *shape, dtype=dtype, device=env.device)

        self.capacity, self.num_worlds = capacity, env.num_worlds
        self._observation, self._following = zeros(features), zeros(features)
        self._action, self._reward = zeros(env.action_size), zeros(len(env.objectives))
        self._terminated, self._over = zeros(dtype=torch.bool), zeros(dtype=torch.bool)
        self.stored = torch.zeros((), dtype=torch.int64, device=env.device)  # steps so far

    def state(self) -> list[Tensor]:
        episodes = self._terminated, self._over, self.stored
        return [self._observation, self._following, self._action, self._reward, *episodes]

    def add(self, rollout: Rollout) -> None:
        """Store the T steps of a rollout in place of the oldest ones."""
        steps = len(rollout.reward)
        rows = (self.stored + torch.arange(steps, device=self.stored.device)) % self.capacity
        pairs = (
            (self._observation, rollout.observation),
            (self._following, rollout.final_observation),
            (self._action, rollout.action.tanh()),
            (self._reward, rollout.reward),
            (self._terminated, rollout.terminated),
            (self._over, rollout.terminated | rollout.truncated),
        )
        for column, values in pairs:
            column.index_copy_(0, rows, values.flatten(1, 2))
        self.stored += steps

    def sample(
        self, number: int, steps: int, discount: float, generator: torch.Generator
    ) -> Transitions:
        """Draw stretches of up to `steps` steps, each from any step of any world.

        A stretch ends after `steps`, the n of n-step returns (Sutton, 1988), or where its episode
        ends, also at a time limit, where the value of the last state still counts, or at the newest
        step. The `discount` is per control step.
        """
        held = self.stored.clamp(max=self.capacity)
        draws = self._reward.new_empty(2, number).uniform_(generator=generator)
        age = (draws[0] * held).long().clamp(max=held - 1)  # 0 is the oldest
        world = (draws[1] * self.num_worlds).long().clamp(max=self.num_worlds - 1)
        oldest = self.stored - held

        def row(later: int) -> Tensor:
            return (oldest + age + later) % self.capacity

        first = last = row(0)
        reward, factor = self._reward[first, world], torch.full_like(draws[0], discount)
        goes_on = ~self._over[first, world]
        for later in range(1, steps):
            here = row(later)
            goes_on = goes_on & (age + later < held)
            gain = factor[:, None] * self._reward[here, world]
            reward = reward + torch.where(goes_on[:, None], gain, 0.0)
            factor = torch.where(goes_on, factor * discount, factor)
            last = torch.where(goes_on, here, last)
            goes_on = goes_on & ~self._over[here, world]
        ended = self._terminated[last, world]
        return Transitions(
            self._observation[first, world],
            self._action[first, world],
            reward,
            self._following[last, world],
            torch.where(ended, 0.0, factor)[:, None],
        )


class HyperSAC(Learner):
    """Trains a hypernetwork of actors and one of twin critics from a replay.

    (Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", for vector rewards.)
    An iteration explores T steps with K trade-offs and stores them. Each of its `method.updates`
    gradient steps draws K new trade-offs and gives each of them transitions of all worlds,
    whichever trade-off acted there: rewards are stored as vectors, so every transition teaches
    every trade-off. Critics predict one soft value per objective, and each sample's target is that
    of the twin with the smaller weighted value. In short control steps, exploration holds its noise
    for a random number of them, `method.hold` seconds on average (after FlashSAC, Kim et al.,
    2026).

    It needs `network.type: dual` and sparse sampling, and uses no option of `ppo`. On CUDA, a
    resumed run starts with an empty replay, as do worlds that cannot be resumed. Arguments and
    errors are those of `MORLAX`, but `critic` must be None. Each process of a group has its own
    replay.
    """

    def _build(self) -> None:
        env, config, group = self.env, self.config, self.group
        if "critic" in self.agent.own_networks():
            raise MorlaxError("algorithm hyper-sac makes its own critics: leave out `critic`.")
        if not env.shows_endings:
            raise MorlaxError(
                "algorithm hyper-sac learns from the last observation of each episode, which these "
                "worlds do not show: choose another algorithm."
            )
        assert isinstance(config.method, HyperSACOptions)
        self.options = config.method
        device, m = env.device, len(env.objectives)
        self.target = copy.deepcopy(self.agent.critic).requires_grad_(False)
        capacity = max(self.options.replay // env.num_worlds, config.horizon)
        self.replay = Replay(capacity, env)
        self._held = 0  # environment steps stored since the replay was empty
        self._losses = self.tradeoffs.new_zeros(len(METRICS))
        self._updates = self.tradeoffs.new_zeros(())  # that losses are sums over
        self._sums += [self._losses, self._updates]
        start = torch.tensor(math.log(self.options.temperature), dtype=torch.float32, device=device)
        self.log_temperature = nn.Parameter(start)
        rate, families = self.options.learning_rate, (self.agent.actor, self.agent.critic)
        self.optimizers = (
            *(ClippedAdam([*x.parameters()], rate, MAX_NORM, group=group) for x in families),
            ClippedAdam([self.log_temperature], TEMPERATURE_RATE, math.inf, group=group),
        )
        self._drawn = self.tradeoffs.clone()  # to learn
        self._noise = torch.zeros_like(self.rollout.action[0])  # that explored last
        hold = self.options.hold
        self._repeat = max(0.0, 1 - env.dt / hold) if hold else 0.0  # probability per step
        self._gains = start.new_zeros(env.num_worlds, m)  # discounted, of episodes
        self._squares = start.new_zeros(m)  # their mean square
        self._seen = start.new_zeros(())  # steps that it is a mean of
        self._process_state |= {"gains": [self._gains], "noise": [self._noise]}
        if env.resumable and device.type == "cpu":
            self._process_state["transitions"] = self.replay.state()
        self._state |= {
            "target": [*self.target.parameters()],
            "optimizers": [x for optimizer in self.optimizers for x in optimizer.state()],
            "temperature": [self.log_temperature.detach()],
            "scale": [self._squares, self._seen],
        }

    def _start_here(self) -> None:
        super()._start_here()
        self._gains.zero_()

    def _record(self) -> None:
        self._explore(1)  # so that there is something to learn from
        super()._record()

    def _learn_from_it(self) -> None:
        if self.iteration == 0:
            self._follow(1.0)  # start_from may have replaced the networks
        self._held += self.config.worlds * self.config.horizon
        if self._held >= self.options.start:
            super()._learn_from_it()

    @torch.no_grad()
    def _explore(self, steps: int | None = None) -> None:
        rollout = self.rollout.first(steps or self.config.horizon)
        with one_thread(self.env.device):
            collect(self.env, self._choose(), self.observation, rollout, self.generator)
        self.replay.add(rollout)
        self.agent.observation_normalizer.update(rollout.observation, self._decay(), self.group)
        self._measure(rollout)
        self._count(rollout)

    def _choose(self) -> Explore:
        """Draw the trade-offs of an iteration, in place, and return how their policies explore."""
        self._draws.fill(self.tradeoffs, self.generator, self._done)
        actors = self.agent.actors(self.tradeoffs)
        if not self._repeat:
            return actors.explore

        def explore(observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
            draws = torch.empty_like(noise[..., :1]).uniform_(generator=self.generator)
            self._noise.copy_(torch.where(draws < self._repeat, self._noise, noise))
            return actors.explore(observation, self._noise)

        return explore

    def _measure(self, rollout: Rollout) -> None:
        """Update the mean square of discounted returns, which scales rewards."""
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
        for optimizer in self.optimizers[:2]:
            optimizer.rate.copy_(optimizer.initial_rate * self._decay())
        for _ in range(rounds or self.options.updates):
            self._improve()

    def _improve(self) -> None:
        """Take a gradient step of critics, actors and temperature."""
        agent, options, K = self.agent, self.options, len(self.tradeoffs)
        target, (actor, critic, tempering) = self.target, self.optimizers
        scale, temperature = self._scale(), self.log_temperature.detach().exp()
        self._draws.fill(self._drawn, self.generator, self._done)
        weights = self._drawn * scale
        weights = (weights / weights.sum(-1, keepdim=True))[:, None]  # (K, 1, m)
        drawn = self.replay.sample(options.batch, options.steps, options.discount, self.generator)
        rows = Transitions(*(column.view(K, -1, column.shape[-1]) for column in drawn))
        normalized = agent.observation_normalizer
        seen, following = normalized(rows.observation), normalized(rows.following)
        actors, critics = agent.policies(self._drawn), agent.critic(self._drawn)

        def acted(policy: TanhNormal) -> tuple[Tensor, Tensor]:
            noise = torch.empty_like(policy.mean).normal_(generator=self.generator)
            action = policy.mean + policy.std * noise
            return action.tanh(), policy.log_prob(action)[..., None]

        with torch.no_grad():
            action, log_prob = acted(actors(following))
            twins = target.run(target(self._drawn), torch.cat([following, action], -1))
            future = smaller(twins, weights) - temperature * log_prob
            wanted = rows.reward / scale + rows.discount * future
        valued = agent.critic.run(critics, torch.cat([seen, rows.action], -1))
        value_loss = (valued - wanted.repeat(1, 1, 2)).square().mean() * valued.shape[-1]
        critic.step(value_loss)

        policy = actors(seen)
        action, log_prob = acted(policy)
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
            self._updates += 1
        self._follow(options.target_rate)
        tempering.step(self.log_temperature.exp() * surplus)

    @torch.no_grad()
    def _follow(self, rate: float) -> None:
        """Take a step of the target critics towards the critics, in place."""
        torch._foreach_lerp_(self._state["target"], [*self.agent.critic.parameters()], rate)

    def _means(self) -> dict[str, Tensor]:
        losses = zip(METRICS, self._losses / self._updates.clamp(min=1), strict=True)
        temperature = self.log_temperature.detach().exp()
        return {**dict(losses), **super()._means(), "temperature": temperature}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        transitions = self._process_state.get("transitions", [])
        if not transitions or "transitions" not in state:
            self.replay.stored.zero_()
            state = {**state, "transitions": transitions}
        super().load_state_dict(state)
        self._held = int(self.replay.stored) * self.config.worlds
