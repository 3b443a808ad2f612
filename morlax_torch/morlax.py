"""MORLAX: explore with the policies of K trade-offs, learn one hypernetwork from all of them."""

from typing import Any

import torch
from torch import nn

from .agent import Agent
from .config import Config
from .envs import MorlaxError, Worlds
from .graph import Graph
from .ppo import PPO, judge, minibatches
from .rollout import Rollout, collect, one_thread
from .tradeoffs import sample_tradeoffs


class MORLAX:
    """Trains an `Agent` in the worlds of an environment, one `iterate` at a time.

    All that it draws comes from one generator, and all that it is stands in tensors that are
    written in place: `state_dict` copies them, `load_state_dict` goes on from a copy as if never
    stopped. On CUDA, call `compile` once, and an iteration becomes two recorded graphs.

    Args:
        env: the worlds.
        config: every number of the run.
        actor: what to generate parameters for instead of the config's own actor: a module from
            observations (B, O) to (B, 2A), means and what becomes the standard deviations.
        critic: likewise, from (B, O + P), with what is privileged, to a value for each objective
            (B, m).

    Raises:
        MorlaxError: config and worlds disagree, or a network does not fit the worlds.
    """

    def __init__(
        self,
        env: Worlds,
        config: Config,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
    ):
        if env.num_worlds != config.worlds:
            raise MorlaxError(
                f"there are {env.num_worlds} worlds, but config.worlds says {config.worlds}."
            )
        self.env, self.config = env, config
        self.agent = Agent(
            env.observation_size,
            env.action_size,
            len(env.objectives),
            config.network,
            torch.Generator().manual_seed(config.seed),
            privileged_size=env.privileged_size,
            actor=actor,
            critic=critic,
        ).to(env.device)
        self.ppo = PPO(self.agent, config.ppo)
        self.generator = torch.Generator(env.device).manual_seed(config.seed)
        clusters = config.num_clusters
        self.tradeoffs = torch.zeros(clusters, len(env.objectives), device=env.device)  # (K, m)
        self.rollout = Rollout.empty(config.horizon, clusters, env)
        env.reset()
        self.observation = env.critic_observation().clone()  # (N, O + P)
        self.iteration = 0
        self._clock = torch.zeros((), device=env.device)  # the iteration, where graphs can see it
        self.steps_per_iteration = config.worlds * config.horizon
        self.metric_names = (
            *PPO.metrics,
            *(f"explained_variance/{name}" for name in env.objectives),
            *(f"mean_reward/{name}" for name in env.objectives),
            "terminated",
        )
        self._metrics = torch.zeros(len(self.metric_names), device=env.device)
        self._metrics_since = 0
        generators = (self.generator, env.generator)
        self.explore = Graph(self._explore, env.device, generators)
        self.learn = Graph(self._learn, env.device, generators)

    @property
    def env_steps(self) -> int:
        """How many environment steps have been learnt from."""
        return self.iteration * self.steps_per_iteration

    def compile(self) -> None:
        """Compile kernels and record the graphs; the state stays as it is."""
        if self.env.device.type != "cuda":
            return
        state = self.state_dict()
        self.explore.record()
        self.learn.record()
        self.load_state_dict(state)
        self._metrics.zero_()

    def iterate(self) -> None:
        """One iteration of MORLAX."""
        self.explore()
        self.learn()
        self.iteration += 1

    def _explore(self) -> None:
        corners = self.config.num_corners(self.tradeoffs.shape[1])
        sample_tradeoffs(self.tradeoffs, corners, self.config.sampling.alpha, self.generator)
        with one_thread(self.env.device):
            collect(
                self.env, self.agent, self.tradeoffs, self.observation, self.rollout, self.generator
            )

    def _learn(self) -> None:
        ppo, left = self.config.ppo, 1.0
        if ppo.anneal and self.config.max_env_steps:
            done = self._clock * (self.steps_per_iteration / self.config.max_env_steps)
            left = (1 - done).clamp(min=0)
            self.ppo.anneal(left)
            self._clock += 1
        batch, explained = judge(self.agent, self.tradeoffs, self.rollout, ppo)
        losses = torch.zeros(len(PPO.metrics), device=self.env.device)
        for _ in range(ppo.epochs):
            parts = minibatches(batch, self.tradeoffs, ppo.minibatches, self.generator)
            losses += self.ppo.improve(parts, self.generator)
        # only now: during the update the policies must see what they saw when they acted; and by
        # less and less, since what policies see must not move on when they can no longer follow
        self.agent.observation_normalizer.update(self.rollout.observation, left)
        reward, terminated = self.rollout.reward, self.rollout.terminated
        self._metrics += torch.cat(
            [
                losses / ppo.epochs,
                explained,
                reward.mean((0, 1, 2)),
                terminated.float().mean()[None],
            ]
        )

    def metrics(self) -> dict[str, float]:
        """Means over the iterations since the last call. Waits for the GPU."""
        iterations = max(1, self.iteration - self._metrics_since)
        self._metrics_since = self.iteration
        values = torch.cat(
            [
                self._metrics / iterations,
                self.env.blowups.float()[None],
                self.env.overflow().max().float()[None],
            ]
        ).tolist()
        self._metrics.zero_()
        return dict(zip((*self.metric_names, "blowups", "overflow"), values, strict=True))

    def state_dict(self) -> dict[str, Any]:
        """A copy of everything that what comes next depends on."""
        return {
            "agent": {name: value.clone() for name, value in self.agent.state_dict().items()},
            "optimizers": [value.clone() for value in self.ppo.state()],
            "generator": self.generator.get_state(),
            "environment": self.env.state_dict(),
            "observation": self.observation.clone(),
            "iteration": self.iteration,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go back to what `state_dict` gave, in place: recorded graphs stay valid."""
        self.agent.load_state_dict(state["agent"])
        for mine, stored in zip(self.ppo.state(), state["optimizers"], strict=True):
            mine.copy_(stored)
        self.generator.set_state(state["generator"].cpu())
        self.env.load_state_dict(state["environment"])
        self.observation.copy_(state["observation"])
        self.iteration = self._metrics_since = state["iteration"]
        self._clock.fill_(self.iteration)
