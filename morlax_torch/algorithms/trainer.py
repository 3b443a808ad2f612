"""One iteration: explore with the policies of K trade-offs, then learn from all that they did."""

from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..envs import MorlaxError, Worlds
from ..envs.devices import restore_generator, seed_of
from ..gpu.graph import Graph
from ..gpu.group import ALONE, Group
from ..gpu.resources import one_thread
from ..networks.agent import Agent
from ..scalarizations.registry import make_scalarization
from .batch import Table, expected_returns, make_batch
from .learner import Learner
from .metrics import read
from .ppo import PPO
from .rollout import Episodes, Rollout, collect

STARTS = 16  # first observations of episodes per trade-off, to estimate returns from


def make_agent(
    env: Worlds, config: Config, in_order: int = 0, **networks: nn.Module | None
) -> Agent:
    """Return a new agent for the worlds, on their device; `Agent` explains the arguments."""
    return Agent(
        config,
        env.observation_size,
        env.action_size,
        len(env.objectives),
        torch.Generator().manual_seed(config.seed),
        privileged_size=env.privileged_size,
        mirror=env.mirror() if config.network.symmetric else None,
        in_order=in_order,
        **networks,
    ).to(env.device)


class Trainer(Learner):
    """Trains an agent with PPO, as all methods do. Subclasses say what is special about them.

    One generator draws everything; all state lives in tensors updated in place.

    `trained` is the agent that explores and learns; `agent`, the one that is evaluated, is the same
    unless a method keeps another.

    Arguments and errors are those of `MORLAX`.
    """

    in_order = False  # trains K independent networks, each with the trade-off in its place

    def __init__(
        self,
        env: Worlds,
        config: Config,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        *,
        group: Group = ALONE,
    ):
        if env.num_worlds != config.worlds:
            raise MorlaxError(
                f"there are {env.num_worlds} worlds, but config.worlds is {config.worlds}."
            )
        if config.ppo.truncation == "bootstrap" and not env.shows_endings:
            raise MorlaxError(
                "these worlds do not show how an episode ended, so there is no value to bootstrap "
                "from: set ppo.truncation to mask."
            )
        self.env, self.config, self.group = env, config, group
        number = config.num_clusters if self.in_order else 0
        agent = make_agent(env, config, number, actor=actor, critic=critic)
        group.share(agent)  # a user's networks may start differently in every process
        self.agent = self.trained = agent
        self.iteration = self.env_steps = 0
        self._own_state: dict[str, Tensor] = {}  # of this process, that not every method has
        self.steps_per_iteration = config.worlds * config.horizon * group.size
        if env.device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32
        self.ppo = PPO(agent, config.ppo, group)
        self.generator = torch.Generator(env.device).manual_seed(seed_of(config.seed, group.rank))
        clusters, m = config.num_clusters, len(env.objectives)
        self.tradeoffs = torch.full((clusters, m), 1 / m, device=env.device)
        self.scalarization = make_scalarization(config.scalarization, env.objectives, env.device)
        self.rollout = Rollout.empty(config.horizon, clusters, env)
        mirror = agent.mirror
        self._reflection = None if mirror is None else mirror.observation.to(env.device)
        env.reset()
        self.observation = env.critic_observation().clone()  # (N, O + P)
        if self.scalarization.uses_returns:
            starts = self.observation.view(clusters, -1, self.observation.shape[1])
            self._starts = starts[:, :STARTS].clone()  # (K, up to STARTS, O + P)
            self._own_state["starts"] = self._starts
        self._done = torch.zeros((), device=env.device)  # of `iterate`, readable by graphs
        values = env.objectives if config.ppo.critic == "vector" else ("utility",)
        self.metric_names = (
            *PPO.metrics,
            *(f"explained_variance/{name}" for name in values),
            *(f"mean_reward/{name}" for name in env.objectives),
            "terminated",
        )
        self._metrics = torch.zeros(len(self.metric_names), device=env.device)
        self._iterations = 0  # that the metrics are of
        self._episodes = Episodes(config.worlds, len(env.objectives), env.device)
        generators = (self.generator, env.generator)
        self.explore = Graph(self._explore, env.device, generators, partial(self._explore, 1))
        self.learn = Graph(self._learn, env.device, [self.generator], partial(self._learn, 1))

    @property
    def per_process(self) -> tuple[str, ...]:
        return "generator", "environment", "observation", "episodes", *self._own_state

    def compile(self) -> None:
        """Compile kernels and record the graphs; all state is unchanged.

        Worlds that cannot be recorded are explored eagerly.
        """
        if self.env.device.type != "cuda":
            return
        state, tradeoffs = self.state_dict(), self.tradeoffs.clone()
        self.learn.record()  # first, while other processes still compile the simulator's kernels
        if self.env.recordable:
            self.explore.record()
        self.load_state_dict(state)
        self.tradeoffs.copy_(tradeoffs)
        self._restart_metrics()

    def iterate(self, done: float = 0.0) -> None:
        if self.env.interrupted:
            self.env.reset()
            self._start_here()
        self._done.fill_(done)
        self.explore()
        self.learn()
        self._iterations += 1
        self.iteration += 1
        self.env_steps += self.steps_per_iteration

    def _start_here(self) -> None:
        """Explore from what the worlds show now, with no episode under way."""
        self.observation.copy_(self.env.critic_observation())
        self._episodes.running.zero_()

    def _draw(self, tradeoffs: Tensor, generator: torch.Generator) -> None:
        """Choose the trade-offs (K, m) of an iteration, in place; by default, they stay.

        Runs inside a recorded graph.
        """

    def _explore(self, steps: int | None = None) -> None:
        """Collect a rollout, or only its first `steps`."""
        self._draw(self.tradeoffs, self.generator)
        with torch.no_grad(), one_thread(self.env.device):
            collect(
                self.env,
                self.trained.actors(self.tradeoffs).explore,
                self.observation,
                self.rollout.first(steps or self.config.horizon),
                self.generator,
            )

    def _weights(self) -> Tensor:
        """Return the weight (K, m) of each objective's advantage."""
        if not self.scalarization.uses_returns:
            return self.scalarization.weights(self.tradeoffs, self.tradeoffs)
        ppo, length = self.config.ppo, self.env.episode_length
        returns = expected_returns(
            self.trained, self.tradeoffs, self._starts, ppo.discount, length, ppo.normalize_values
        )
        self.scalarization.observe(self.tradeoffs, returns, self.group)
        weights = self.scalarization.weights(self.tradeoffs, returns)
        # only the direction counts, so that no trade-off learns faster than another
        return weights / weights.abs().sum(-1, keepdim=True).clamp(min=1e-12)

    def _learn(self, epochs: int | None = None) -> None:
        """Learn from the rollout for `epochs` (None: the config's)."""
        config, decay = self.config.ppo, torch.ones_like(self._done)
        if config.decay_fraction:
            decay = ((1 - self._done) / config.decay_fraction).clamp(max=1.0)
            self.ppo.decay(decay)
        batch, explained = make_batch(
            self.trained, self.tradeoffs, self.rollout, config, self._weights(), self.group
        )
        losses = torch.zeros(len(PPO.metrics), device=self.env.device)
        table = Table(batch)
        for _ in range(epochs or config.epochs):
            parts = table.minibatches(self.tradeoffs, config.minibatches, self.generator)
            losses += self.ppo.improve(parts, self.generator)
        # Only now: during the update the policies must see the inputs that they acted on. Decayed
        # too, since policies cannot follow a moving normalizer once their learning rate is zero.
        seen = self.rollout.observation
        if self._reflection:  # statistics are symmetric too
            seen = torch.cat([seen, self._reflection(seen)])
        self.trained.observation_normalizer.update(seen, decay, self.group)
        self._episodes.observe(self.rollout)
        reward = self.rollout.reward.mean((0, 1, 2))
        terminated = self.rollout.terminated.float().mean()[None]
        self._metrics += torch.cat([losses / config.epochs, explained, reward, terminated])

    def metrics(self) -> dict[str, float]:
        """Return means over the iterations since the last call, and over all processes.

        Episode returns and lengths are those of episodes that ended since then, if any did. Waits
        for the GPU, and for the other processes, which must call it too.
        """
        iterations = max(1, self._iterations)
        updates = iterations * self.config.ppo.epochs * self.config.ppo.minibatches
        optimizers = dict(zip(self.ppo.optimizer_names, self.ppo.optimizers, strict=True))
        parts = {
            **dict(zip(self.metric_names, self._metrics / iterations, strict=True)),
            **{f"learning_rate/{name}": own.rate for name, own in optimizers.items()},
            **{f"gradient_norm/{name}": own.norms / updates for name, own in optimizers.items()},
            **self.scalarization.metrics(self.env.objectives),
        }
        found = read(parts, self.env, self._episodes, self.group)
        self._restart_metrics()
        return found

    def _restart_metrics(self) -> None:
        self._iterations = 0
        sums = self._metrics, self._episodes.totals, *(each.norms for each in self.ppo.optimizers)
        for value in sums:
            value.zero_()

    def state_dict(self) -> dict[str, Any]:
        """Copy everything that future iterations depend on.

        Worlds that are not resumable are left out, and go on as they are after `load_state_dict`.
        """
        return {
            **{name: value.clone() for name, value in self._own_state.items()},
            "agent": {name: value.clone() for name, value in self.trained.state_dict().items()},
            "optimizers": [value.clone() for value in self.ppo.state()],
            "scalarization": [value.clone() for value in self.scalarization.state()],
            "generator": self.generator.get_state(),
            "environment": self.env.state_dict() if self.env.resumable else {},
            "observation": self.observation.clone(),
            "episodes": self._episodes.running.clone(),
            "iteration": self.iteration,
            "env_steps": self.env_steps,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.trained.load_state_dict(state["agent"])
        self.ppo.restore(state["optimizers"])
        stored = state.get("scalarization", [])
        for mine, value in zip(self.scalarization.state(), stored, strict=True):
            mine.copy_(value)
        for name, value in self._own_state.items():
            value.copy_(state[name])
        restore_generator(self.generator, state["generator"])
        if self.env.resumable:
            self.env.load_state_dict(state["environment"])
            self.observation.copy_(state["observation"])
            if "episodes" in state:  # checkpoints of version 0.1 lack it
                self._episodes.running.copy_(state["episodes"])
        else:
            self._start_here()
        self._iterations, self.iteration = 0, state["iteration"]
        # before several processes could train, every iteration had as many
        self.env_steps = state.get("env_steps", self.iteration * self.steps_per_iteration)
