"""Soft actor-critic for a hypernetwork of policies, which learn from each other's transitions."""

import copy
import math
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from ...configuration.config import Config
from ...configuration.sections import HyperSACOptions
from ...envs import MorlaxError, Worlds
from ...envs.devices import restore_generator, seed_of
from ...gpu.graph import Graph
from ...gpu.group import ALONE, Group
from ...gpu.optimizer import ClippedAdam
from ...gpu.resources import one_thread
from ...networks.gaussian import TanhNormal
from ..learner import Learner
from ..methods import draw
from ..metrics import read
from ..rollout import Episodes, Rollout, collect
from ..trainer import make_agent
from .replay import Replay, Transitions

TYPICAL = 50.0  # root mean square of scaled returns
MAX_NORM = 10.0  # of gradients
TEMPERATURE_RATE = 3e-3  # learning rate
LOSSES = ("policy_loss", "value_loss", "entropy", "action_std")


class HyperSAC(Learner):
    """Trains a hypernetwork of actors and one of twin critics from a replay.

    (Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", for vector rewards.)
    Each iteration explores T steps with K trade-offs, then takes `method.updates` gradient steps.
    Each of these draws K new trade-offs and gives each of them transitions of all worlds, whichever
    trade-off acted there: rewards are stored as vectors, so every transition teaches every
    trade-off. Critics predict one soft value per objective, and each sample's target is that of the
    twin with the smaller weighted value.

    It needs `network.type: dual` and sparse sampling, and uses no option of `ppo`. On CUDA, a
    resumed run starts with an empty replay, as do worlds that cannot be resumed.

    Args:
        env: the worlds.
        config: every number of the run.
        actor: replaces the config's actor, as in `MORLAX`.
        critic: must be None.
        group: processes that train the same agent, each in its own worlds with its own replay.

    Raises:
        MorlaxError: config and worlds disagree, or a network does not fit the worlds.
    """

    def __init__(
        self,
        env: Worlds,
        config: Config,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        *,
        group: Group = ALONE,
    ):
        assert isinstance(config.method, HyperSACOptions)
        if critic is not None:
            raise MorlaxError("algorithm hyper-sac makes its own critics: leave out `critic`.")
        if env.num_worlds != config.worlds:
            raise MorlaxError(
                f"there are {env.num_worlds} worlds, but config.worlds is {config.worlds}."
            )
        if not env.shows_endings:
            raise MorlaxError(
                "algorithm hyper-sac learns from the last observation of each episode, which these "
                "worlds do not show: choose another algorithm."
            )
        self.env, self.config, self.group, self.options = env, config, group, config.method
        self.agent = make_agent(env, config, actor=actor)
        group.share(self.agent)
        self.iteration = self.env_steps = 0
        self.steps_per_iteration = config.worlds * config.horizon * group.size
        device, m = env.device, len(env.objectives)
        if device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32
        self.target = copy.deepcopy(self.agent.critic).requires_grad_(False)
        start = torch.tensor(math.log(self.options.temperature), device=device)
        self.log_temperature = nn.Parameter(start)
        rate = self.options.learning_rate
        families = self.agent.actor, self.agent.critic
        self.optimizers = (
            *(ClippedAdam([*own.parameters()], rate, MAX_NORM, group=group) for own in families),
            ClippedAdam([self.log_temperature], TEMPERATURE_RATE, math.inf, group=group),
        )
        self.generator = torch.Generator(device).manual_seed(seed_of(config.seed, group.rank))
        self.tradeoffs = torch.full((config.num_clusters, m), 1 / m, device=device)
        self._drawn = self.tradeoffs.clone()  # to learn
        self.rollout = Rollout.empty(config.horizon, config.num_clusters, env)
        capacity = max(self.options.replay // env.num_worlds, config.horizon)
        self.replay = Replay(capacity, env)
        self._keeps_replay = env.resumable and device.type == "cpu"  # in checkpoints
        self._held = 0  # environment steps stored since the replay was empty
        self._gains = torch.zeros(env.num_worlds, m, device=device)  # discounted, of episodes
        self._squares = torch.zeros(m, device=device)  # their mean square
        self._seen = torch.zeros((), device=device)  # steps that it is a mean of
        env.reset()
        self.observation = env.critic_observation().clone()  # (N, O + P)
        self._done = torch.zeros((), device=device)
        self._episodes = Episodes(config.worlds, m, device)
        self._sums = torch.zeros(len(LOSSES), device=device)
        self._rewards = torch.zeros(m + 1, device=device)
        self._updates = self._iterations = 0  # that these are sums over
        generators = [self.generator, env.generator]
        self.explore = Graph(self._explore, device, generators, partial(self._explore, 1))
        self.learn = Graph(self._learn, device, [self.generator], partial(self._learn, 1))

    @property
    def per_process(self) -> tuple[str, ...]:
        return "generator", "environment", "observation", "episodes", "gains", "replay"

    def compile(self) -> None:
        if self.env.device.type != "cuda":
            return
        state = self.state_dict()
        self._explore(1)  # so that there is something to learn from
        self.learn.record()
        if self.env.recordable:
            self.explore.record()
        self.load_state_dict(state)
        self._restart_metrics()

    def iterate(self, done: float = 0.0) -> None:
        if self.env.interrupted:
            self.env.reset()
            self._start_here()
        self._done.fill_(done)
        self.explore()
        self._held += self.config.worlds * self.config.horizon
        if self._held >= self.options.start:
            self.learn()
            self._updates += self.options.updates
        self._iterations += 1
        self.iteration += 1
        self.env_steps += self.steps_per_iteration

    def _start_here(self) -> None:
        """Explore from what the worlds show now, with no episode under way."""
        self.observation.copy_(self.env.critic_observation())
        self._episodes.running.zero_()
        self._gains.zero_()

    @torch.no_grad()
    def _explore(self, steps: int | None = None) -> None:
        """Collect a rollout, or only its first `steps`, and store it."""
        draw(self.config, self.tradeoffs, self.generator, self._done)
        rollout = self.rollout.first(steps or self.config.horizon)
        with one_thread(self.env.device):
            actors = self.agent.actors(self.tradeoffs)
            collect(self.env, actors, self.observation, rollout, self.generator)
        self.replay.add(rollout)
        self.agent.observation_normalizer.update(rollout.observation, group=self.group)
        self._observe_returns(rollout)
        self._episodes.observe(rollout)
        terminated = rollout.terminated.float().mean()[None]
        self._rewards += torch.cat([rollout.reward.mean((0, 1, 2)), terminated])

    def _observe_returns(self, rollout: Rollout) -> None:
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

    def _learn(self, updates: int | None = None) -> None:
        if self.options.decay_fraction:
            left = ((1 - self._done) / self.options.decay_fraction).clamp(max=1.0)
            for optimizer in self.optimizers[:2]:
                optimizer.rate.copy_(self.options.learning_rate * left)
        for _ in range(updates or self.options.updates):
            self._improve()

    def _improve(self) -> None:
        """Take a gradient step of critics, actors and temperature."""
        agent, options, K = self.agent, self.options, len(self.tradeoffs)
        actor, critic, tempering = self.optimizers
        scale, temperature = self._scale(), self.log_temperature.detach().exp()
        draw(self.config, self._drawn, self.generator, self._done)
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
            found = self.target.run(self.target(self._drawn), torch.cat([following, action], -1))
            one, other = found.chunk(2, -1)
            less = (one * weights).sum(-1, True) < (other * weights).sum(-1, True)
            future = torch.where(less, one, other) - temperature * log_prob
            wanted = rows.reward / scale + rows.discount * future
        valued = agent.critic.run(critics, torch.cat([seen, rows.action], -1))
        value_loss = (valued - wanted.repeat(1, 1, 2)).square().mean() * valued.shape[-1]
        critic.step(value_loss)

        policy = actors(seen)
        action, log_prob = acted(policy.output)
        critics = agent.critic(self._drawn)
        found = agent.critic.run(critics, torch.cat([seen, action], -1))
        value = torch.minimum(*((part * weights).sum(-1, True) for part in found.chunk(2, -1)))
        policy_loss = (temperature * log_prob - value).mean()
        actor.step(policy_loss)

        with torch.no_grad():
            entropy = -log_prob.mean()
            surplus = entropy - options.entropy * self.env.action_size
            torch._foreach_lerp_(
                list(self.target.parameters()),
                list(agent.critic.parameters()),
                options.target_rate,
            )
            losses = policy_loss, value_loss, entropy, policy.std.mean()
            self._sums += torch.stack([loss.detach() for loss in losses])
        tempering.step(self.log_temperature.exp() * surplus)

    def metrics(self) -> dict[str, float]:
        rewards = [*(f"mean_reward/{name}" for name in self.env.objectives), "terminated"]
        parts = {
            **dict(zip(LOSSES, self._sums / max(1, self._updates), strict=True)),
            **dict(zip(rewards, self._rewards / max(1, self._iterations), strict=True)),
            "temperature": self.log_temperature.detach().exp(),
        }
        found = read(parts, self.env, self._episodes, self.group)
        self._restart_metrics()
        return found

    def _restart_metrics(self) -> None:
        self._updates = self._iterations = 0
        sums = self._sums, self._rewards, self._episodes.totals
        for value in (*sums, *(optimizer.norms for optimizer in self.optimizers)):
            value.zero_()

    def _tensors(self) -> dict[str, list[Tensor]]:
        """Return the tensors of the state, without those of agent and worlds, by name."""
        return {
            "target": list(self.target.parameters()),
            "optimizers": [x for optimizer in self.optimizers for x in optimizer.state()],
            "temperature": [self.log_temperature.detach()],
            "scale": [self._squares, self._seen],
            "gains": [self._gains],
            "replay": self.replay.state() if self._keeps_replay else [],
        }

    def state_dict(self) -> dict[str, Any]:
        tensors = self._tensors().items()
        return {
            **{name: [value.detach().clone() for value in values] for name, values in tensors},
            "agent": {name: value.clone() for name, value in self.agent.state_dict().items()},
            "generator": self.generator.get_state(),
            "environment": self.env.state_dict() if self.env.resumable else {},
            "observation": self.observation.clone(),
            "episodes": self._episodes.running.clone(),
            "held": self._held,
            "iteration": self.iteration,
            "env_steps": self.env_steps,
        }

    @torch.no_grad()
    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.agent.load_state_dict(state["agent"])
        for name, values in self._tensors().items():
            for mine, stored in zip(values, state[name], strict=False):
                mine.copy_(stored)
        restore_generator(self.generator, state["generator"])
        if self.env.resumable:
            self.env.load_state_dict(state["environment"])
            self.observation.copy_(state["observation"])
            self._episodes.running.copy_(state["episodes"])
        else:
            self._start_here()
        self._held = state["held"]
        if not (self._keeps_replay and state["replay"]):
            self.replay.clear()
            self._held = 0
        self._iterations, self.iteration = 0, state["iteration"]
        self.env_steps = state["env_steps"]
