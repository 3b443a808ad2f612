"""The interface of every learner, which the training loop drives, and what all learners share."""

from abc import ABC, abstractmethod
from functools import partial
from typing import Any, ClassVar
from weakref import ref

import numpy as np
import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.tradeoffs import even_tradeoffs, sample_cells, sample_tradeoffs
from ..envs import MorlaxError, Worlds
from ..envs.devices import restore_generator, seed_of
from ..envs.errors import user_code
from ..envs.worlds.mirror import checked
from ..gpu.graph import Graph
from ..gpu.group import ALONE, Group
from ..networks.agent import Agent
from .rollout import Episodes, Rollout


def make_agent(env: Worlds, config: Config, **networks: Any) -> Agent:
    """Return a new agent for the worlds, on their device; `networks` are arguments of `Agent`."""
    generator = torch.Generator().manual_seed(config.seed)
    with torch.device("cpu"):  # also if scripts set another default device
        if config.network.symmetric:
            # a tolerance only if there is one: tasks may override `mirror` without
            tolerance = config.network.symmetry_tolerance
            with user_code(f"{type(env).__name__}.mirror() fails"):
                mirror = env.mirror(tolerance) if tolerance else env.mirror()
                networks["mirror"] = checked(mirror, env)
        return Agent(config, env, generator, **networks).to(env.device)


class TradeoffDraws:
    """Draws trade-offs (K, m) as `config.sampling` says."""

    def __init__(self, config: Config, num_objectives: int, device: torch.device):
        sampling = config.sampling
        self._alpha = sampling.alpha
        self._corners = config.num_corners(num_objectives)
        self._focus: Tensor | None = None
        if sampling.focus is not None:
            *weights, self._until = sampling.focus
            focus = torch.tensor(weights, dtype=torch.float32, device=device)
            self._focus = focus / focus.sum()
        self._centers: Tensor | None = None  # of the cells
        others = config.num_clusters - self._corners
        if sampling.cells and sampling.mode == "sparse" and others >= num_objectives:
            self._centers = even_tradeoffs(others, num_objectives).to(device)

    def fill(self, out: Tensor, generator: torch.Generator, done: Tensor) -> None:
        """Fill `out` (K, m) when a share () of training is done. Runs inside a recorded graph."""
        if self._centers is None:
            sample_tradeoffs(out, self._corners, self._alpha, generator)
        else:
            sample_cells(out[: len(self._centers)], self._centers, generator)
            out[len(self._centers) :] = torch.eye(self._corners, out.shape[1], device=out.device)
        if self._focus is not None:
            away = (done / self._until).clamp(max=1.0)
            out.copy_(torch.lerp(self._focus, out, away))


class Learner(ABC):
    """Trains an agent in worlds, one `iterate` at a time. `MORLAX` is one.

    An iteration explores T steps with K trade-offs, then learns; each half is recorded as a CUDA
    graph. One generator draws everything; all state lives in tensors updated in place. Arguments
    and errors are those of `MORLAX`.
    """

    algorithm: ClassVar[str | None] = None
    """The only algorithm that a config may name; None: any."""
    group: Group
    """The processes that train together. `state_dict` copies the state of this process."""
    steps_per_iteration: int
    """Environment steps of an iteration, in all processes."""
    env_steps: int
    """Environment steps learned from so far, in all processes."""
    rates: np.ndarray | None = None
    """Mean rewards per control step of each trade-off in training, and its share of steps that
    failed: (K, m + 1), as `metrics` found them last; None until an episode has ended."""

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
        if not env.auto_reset:
            raise MorlaxError("worlds to learn in need auto_reset=True, to begin new episodes.")
        if self.algorithm not in (None, config.algorithm):
            raise MorlaxError(
                f"the config is for algorithm {config.algorithm}, but {type(self).__name__} is "
                f"{self.algorithm}: use morlax_torch.train.train, which makes the right learner."
            )
        ours, theirs = config.task.model_dump(), env.options.model_dump()
        names = [name for name, value in ours.items() if value != theirs.get(name)]
        if names or env.objectives != (*ours["objectives"],):  # in another order
            raise MorlaxError(
                f"the worlds differ from config.task in {', '.join(names) or 'objectives'}: make "
                "them with config.make_worlds(config.worlds, seed)."
            )
        self.env, self.config, self.group = env, config, group
        self.agent = make_agent(env, config, actor=actor, critic=critic)
        group.share(self.agent)  # a user's networks may start differently in every process
        self.iteration = self.env_steps = 0
        self.steps_per_iteration = config.worlds * config.horizon * group.size
        device, m = env.device, len(env.objectives)
        if device.type == "cuda":
            torch.set_float32_matmul_precision("high")  # TF32
        self.generator = torch.Generator(device).manual_seed(seed_of(config.seed, group.rank))
        shape = config.num_clusters, m
        self.tradeoffs = torch.full(shape, 1 / m, dtype=torch.float32, device=device)
        self._draws = TradeoffDraws(config, m, device)
        self.rollout = Rollout.empty(config.horizon, config.num_clusters, env)
        env.reset()
        env.moved_by = ref(self)
        self.observation = env.critic_observation().clone()  # (N, O + P)
        self._done = self.tradeoffs.new_zeros(())  # of `iterate`, readable by graphs
        self._episodes = Episodes(config.worlds, m, device)
        # means of an iteration, and terminations, summed over iterations
        self._rewards = self.tradeoffs.new_zeros(config.num_clusters, m + 1)
        self._iterations = 0  # that metrics are sums over
        self._sums = [self._episodes.totals, self._rewards]  # that metrics are computed from
        # further state by name, updated in place: of all processes, and of this one alone
        self._state: dict[str, list[Tensor]] = {}
        self._process_state: dict[str, list[Tensor]] = {}
        generators = [self.generator, env.generator]
        self.explore = Graph(self._explore, device, generators, partial(self._explore, 1))
        self.learn = Graph(self._learn, device, [self.generator], partial(self._learn, 1))
        self._build()

    @abstractmethod
    def _build(self) -> None:
        """Add what this kind of learner has; raises MorlaxError if the worlds do not suit it."""

    @abstractmethod
    def _explore(self, steps: int | None = None) -> None:
        """Collect a rollout, or only its first `steps`. Runs inside a recorded graph."""

    @abstractmethod
    def _learn(self, rounds: int | None = None) -> None:
        """Learn from the rollout, so many times (None: as the config says). Runs inside a graph."""

    @property
    def per_process(self) -> tuple[str, ...]:
        """Keys of the state that differ between processes."""
        return "generator", "environment", "observation", "episodes", *self._process_state

    def compile(self) -> None:
        """Compile kernels and record the graphs; all state is unchanged.

        Worlds that cannot be recorded are explored eagerly.
        """
        if self.env.device.type != "cuda":
            return
        # warming up explores and learns for a moment, which changes all of this
        state, tradeoffs = self.state_dict(), self.tradeoffs.clone()
        self._record()
        if self.env.recordable:
            self.explore.record()
        self.load_state_dict(state)
        self.tradeoffs.copy_(tradeoffs)

    def _record(self) -> None:
        # before exploring, while other processes still compile the simulator's kernels
        self.learn.record()

    @torch.inference_mode(False)  # learns also inside a user's no_grad
    def iterate(self, done: float = 0.0) -> None:
        """Run one iteration, of a run of which the share `done` is over, from 0 to 1."""
        interrupted = self.env.interrupted
        if interrupted:
            self.env.reset()
        if interrupted or self.env.moved_by is not ref(self):
            self._start_here()
        self._done.fill_(done)
        self.explore()
        self._learn_from_it()
        self._iterations += 1
        self.iteration += 1
        self.env_steps += self.steps_per_iteration

    def _learn_from_it(self) -> None:
        self.learn()

    def _decay(self) -> Tensor:
        """Return the factor () of learning rates at this time of the run."""
        if not self.config.decay_fraction:
            return torch.ones_like(self._done)
        return ((1 - self._done) / self.config.decay_fraction).clamp(max=1.0)

    def _count(self, rollout: Rollout) -> None:
        """Add a rollout to the sums of metrics. Runs inside a recorded graph."""
        self._episodes.observe(rollout)
        terminated = rollout.terminated.float().mean((0, 2))[:, None]
        self._rewards += torch.cat([rollout.reward.mean((0, 2)), terminated], -1)

    def metrics(self) -> dict[str, float]:
        """Return means over the iterations since the last call, and over all processes.

        Episode returns and lengths are those of episodes that ended since then, if any did.
        "blowups" and "overflow" are always there. "entropy" and every metric that ends in "_loss"
        must be finite, else training stops. All processes must call it. It waits for the GPU.
        """
        env, group = self.env, self.group
        means = {**self._means(), "blowups": env.blowups.float()}
        rates, totals = self._rewards / max(1, self._iterations), self._episodes.totals
        # one copy to the CPU, since each waits for the GPU
        sums = group.mean_(torch.cat([rates.flatten(), torch.stack([*means.values(), *totals])]))
        overflow = group.largest_(env.overflow().max().float()[None])
        *values, largest = torch.cat([sums, overflow]).tolist()
        means_by_tradeoff, values = values[: rates.numel()], values[rates.numel() :]
        metrics = dict(zip(means, values, strict=False))
        metrics["blowups"] *= group.size
        *totals, number = values[len(means) :]
        if number or self.rates is not None:  # before, it is unknown how long episodes last
            self.rates = np.reshape(means_by_tradeoff, rates.shape)
        if number:
            names = [*(f"episode_return/{name}" for name in env.objectives), "episode_length"]
            metrics |= {name: x / number for name, x in zip(names, totals, strict=True)}
        self._restart_metrics()
        return {**metrics, "overflow": largest}

    def _means(self) -> dict[str, Tensor]:
        """Return metrics () of this process, means over the iterations since the last call."""
        names = [*(f"mean_reward/{name}" for name in self.env.objectives), "terminated"]
        return dict(zip(names, self._rewards.mean(0) / max(1, self._iterations), strict=True))

    def _restart_metrics(self) -> None:
        self._iterations = 0
        for value in self._sums:
            value.zero_()

    def _start_here(self) -> None:
        """Explore from what the worlds show now, with no episode under way."""
        self.observation.copy_(self.env.critic_observation())
        self._episodes.running.zero_()
        self.env.moved_by = ref(self)

    def state_dict(self) -> dict[str, Any]:
        """Copy everything that future iterations depend on; "agent" holds the agent's state.

        Worlds that are not resumable go on as they are after `load_state_dict`, but for what their
        own state holds, such as levels of difficulty.
        """
        tensors = self._state | self._process_state
        return {
            **{name: [x.detach().clone() for x in values] for name, values in tensors.items()},
            "agent": {name: value.clone() for name, value in self.agent.state_dict().items()},
            "generator": self.generator.get_state(),
            "environment": self.env.state_dict(),
            "observation": self.observation.clone(),
            "episodes": self._episodes.running.clone(),
            "iteration": self.iteration,
            "env_steps": self.env_steps,
        }

    @torch.no_grad()
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state in place, so that recorded graphs stay valid."""
        for name, values in (self._state | self._process_state).items():
            for mine, stored in zip(values, state[name], strict=True):
                mine.copy_(stored.view_as(mine))  # never broadcast
        self.agent.load_state_dict(state["agent"])
        restore_generator(self.generator, state["generator"])
        if worlds := state["environment"]:  # else, these save nothing
            self.env.load_state_dict(worlds)
        if self.env.resumable:
            self.observation.copy_(state["observation"].view_as(self.observation))
            self._episodes.running.copy_(state["episodes"])
            self.env.moved_by = ref(self)
        else:
            self._start_here()
        self._restart_metrics()
        self.iteration, self.env_steps = state["iteration"], state["env_steps"]
