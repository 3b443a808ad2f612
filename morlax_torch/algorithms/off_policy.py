"""Learning from a replay: the last transitions, and the schedule of exploring and updates."""

import copy
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from ..configuration.config import Config
from ..configuration.sections import OffPolicyOptions
from ..envs import MorlaxError, Worlds
from ..gpu.group import ALONE, Group
from ..gpu.optimizer import ClippedAdam
from ..host.resources import memory_of, one_thread
from .learner import Learner, make_agent
from .rollout import Explore, Rollout, collect

MOST = 0.5  # share of the memory that a replay may take


class Transitions(NamedTuple):
    """S steps, or stretches of a few, in any worlds."""

    observation: Tensor  # (S, O + P) raw, as critics see it
    action: Tensor  # (S, A) in (-1, 1)
    reward: Tensor  # (S, m) discounted sum over the stretch
    following: Tensor  # (S, O + P) raw, after the stretch and before any reset
    discount: Tensor  # (S, 1) of the value of `following`: 0 if the episode terminated there
    tradeoff: Tensor  # (S, m) that acted


class Replay:
    """A ring of the last R = `capacity` steps of N worlds in K `clusters`, on their device.

    Nothing waits for the GPU, so storing and sampling can be recorded.
    """

    def __init__(self, capacity: int, clusters: int, env: Worlds):
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
        self._tradeoff = self._reward.new_zeros(capacity, clusters, self._reward.shape[-1])
        self._stored = torch.zeros((), dtype=torch.int64, device=env.device)  # steps so far

    def state(self) -> list[Tensor]:
        episodes = self._terminated, self._over, self._stored, self._tradeoff
        return [self._observation, self._following, self._action, self._reward, *episodes]

    def clear(self) -> None:
        self._stored.zero_()

    def add(self, rollout: Rollout, tradeoffs: Tensor) -> None:
        """Store the T steps of a rollout with trade-offs (K, m) in place of the oldest ones."""
        steps = len(rollout.reward)
        rows = (self._stored + torch.arange(steps, device=self._stored.device)) % self.capacity
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
        self._tradeoff.index_copy_(0, rows, tradeoffs.expand(steps, -1, -1))
        self._stored += steps

    def sample(
        self, number: int, steps: int, discount: float, generator: torch.Generator
    ) -> Transitions:
        """Draw stretches of up to `steps` steps, each from any step of any world.

        A stretch ends after `steps`, the n of n-step returns (Sutton, 1988), or where its episode
        ends, also at a time limit, where the value of the last state still counts, or at the newest
        step. The `discount` is per control step.
        """
        held = self._stored.clamp(max=self.capacity)
        draws = self._reward.new_empty(2, number).uniform_(generator=generator)
        age = (draws[0] * held).long().clamp(max=held - 1)  # 0 is the oldest
        world = (draws[1] * self.num_worlds).long().clamp(max=self.num_worlds - 1)
        oldest = self._stored - held

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
            self._tradeoff[first, world // (self.num_worlds // self._tradeoff.shape[1])],
        )


class OffPolicy(Learner):
    """Explores T steps with K trade-offs, stores them, and improves the agent from the replay.

    It needs sparse sampling, and uses no option of `ppo`. On CUDA, a resumed run starts with an
    empty replay, as do worlds that cannot be resumed. Arguments and errors are those of `MORLAX`,
    but `critic` must be None. Each process of a group has its own replay.
    """

    losses: ClassVar[tuple[str, ...]]  # names of the metrics that `_improve` adds up
    followed: ClassVar[tuple[str, ...]]  # families of the agent that have targets
    optimizers: tuple[ClippedAdam, ...]

    def __init__(
        self,
        env: Worlds,
        config: Config,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        *,
        group: Group = ALONE,
    ):
        options = config.method
        assert isinstance(options, OffPolicyOptions)
        if critic is not None:
            raise MorlaxError(
                f"algorithm {config.algorithm} makes its own critics: leave out `critic`."
            )
        if not env.shows_endings:
            raise MorlaxError(
                f"algorithm {config.algorithm} learns from the last observation of each episode, "
                "which these worlds do not show: choose another algorithm."
            )
        super().__init__(env, config, make_agent(env, config, actor=actor), group)
        families = [getattr(self.agent, name) for name in self.followed]
        self.targets = [copy.deepcopy(family).requires_grad_(False) for family in families]
        capacity = max(options.replay_size // env.num_worlds, config.horizon)
        self.replay = Replay(capacity, config.num_clusters, env)
        if env.resumable and env.device.type == "cpu":
            self._process_state["replay"] = self.replay.state()
        self._held = 0  # environment steps stored since the replay was empty
        self._start, self._rounds = options.start, options.updates // options.delay
        self._losses = self.tradeoffs.new_zeros(len(self.losses))
        self._sums.append(self._losses)
        self._updates = 0  # that losses are sums over
        self._state["target"] = [x for target in self.targets for x in target.parameters()]

    @abstractmethod
    def _choose(self) -> Explore:
        """Draw the trade-offs of an iteration, in place, and return how their policies explore."""

    @abstractmethod
    def _improve(self) -> None:
        """Learn from a minibatch, or a few, and add to `_losses`."""

    def _record(self) -> None:
        self._explore(1)  # so that there is something to learn from
        super()._record()

    def _learn_from_it(self) -> None:
        if self.iteration == 0:
            self._follow(1.0)  # start_from may have replaced the networks
        self._held += self.config.worlds * self.config.horizon
        if self._held >= self._start:
            super()._learn_from_it()
            self._updates += self._rounds

    @torch.no_grad()
    def _explore(self, steps: int | None = None) -> None:
        rollout = self.rollout.first(steps or self.config.horizon)
        with one_thread(self.env.device):
            explore = self._choose()
            collect(self.env, explore, self.observation, rollout, self.generator)
        self.replay.add(rollout, self.tradeoffs)
        self.agent.observation_normalizer.update(rollout.observation, group=self.group)
        self._observe(rollout)
        self._count(rollout)

    def _observe(self, rollout: Rollout) -> None:
        """Keep statistics of a rollout; by default, none."""

    def _learn(self, rounds: int | None = None) -> None:
        for _ in range(rounds or self._rounds):
            self._improve()

    def _means(self) -> dict[str, Tensor]:
        losses = zip(self.losses, self._losses / max(1, self._updates), strict=True)
        return {**dict(losses), **super()._means()}

    def _restart_metrics(self) -> None:
        super()._restart_metrics()
        self._updates = 0

    @torch.no_grad()
    def _follow(self, rate: float) -> None:
        """Take a step of the target networks towards the networks, in place."""
        sources = [x for name in self.followed for x in getattr(self.agent, name).parameters()]
        torch._foreach_lerp_(self._state["target"], sources, rate)

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "held": self._held}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        replay = self._process_state.get("replay", [])
        if not replay or "replay" not in state:
            self.replay.clear()
            state = {**state, "held": 0, "replay": replay}
        super().load_state_dict(state)
        self._held = state["held"]
