"""What learners from a replay share: storing what they explore, and the schedule of updates."""

import copy
from abc import abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from ...configuration.config import Config
from ...configuration.sections import OffPolicyOptions
from ...envs import MorlaxError, Worlds
from ...gpu.group import ALONE, Group
from ...gpu.optimizer import ClippedAdam
from ...host.resources import one_thread
from ..base import BaseLearner, copies, make_agent, restore
from ..rollout import Explore, Rollout, collect
from .replay import Replay


class OffPolicy(BaseLearner):
    """Explores T steps with K trade-offs, stores them, and improves the agent from the replay.

    It needs sparse sampling, and uses no option of `ppo`. On CUDA, a resumed run starts with an
    empty replay, as do worlds that cannot be resumed.

    Args:
        env: the worlds.
        config: every number of the run.
        actor: replaces the config's actor, as in `MORLAX`.
        critic: must be None.
        group: processes that train the same agent, each in its own worlds with its own replay.

    Raises:
        MorlaxError: config and worlds disagree, or a network does not fit the worlds.
    """

    losses: ClassVar[tuple[str, ...]]  # names of the metrics that `_improve` sums
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
        device, m = env.device, len(env.objectives)
        families = [getattr(self.agent, name) for name in self.followed]
        self.targets = [copy.deepcopy(family).requires_grad_(False) for family in families]
        capacity = max(options.replay_size // env.num_worlds, config.horizon)
        self.replay = Replay(capacity, config.num_clusters, env)
        self._keeps_replay = env.resumable and device.type == "cpu"  # in checkpoints
        self._held = 0  # environment steps stored since the replay was empty
        self._start, self._rounds = options.start, options.rounds
        self._sums = torch.zeros(len(self.losses), dtype=torch.float32, device=device)
        self._rewards = torch.zeros(m + 1, dtype=torch.float32, device=device)
        self._updates = 0  # that losses are sums over

    @abstractmethod
    def _choose(self) -> Explore:
        """Draw the trade-offs of an iteration, in place, and return how their policies explore."""

    @abstractmethod
    def _improve(self) -> None:
        """Learn from a minibatch, or a few, and add to `_sums`."""

    @property
    def per_process(self) -> tuple[str, ...]:
        return *super().per_process, *(["replay"] if self._keeps_replay else [])

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
        self._episodes.observe(rollout)
        terminated = rollout.terminated.float().mean()[None]
        self._rewards += torch.cat([rollout.reward.mean((0, 1, 2)), terminated])

    def _observe(self, rollout: Rollout) -> None:
        """Keep statistics of a rollout; by default, none."""

    def _learn(self, rounds: int | None = None) -> None:
        for _ in range(rounds or self._rounds):
            self._improve()

    def metrics(self) -> dict[str, float]:
        rewards = [*(f"mean_reward/{name}" for name in self.env.objectives), "terminated"]
        parts = {
            **dict(zip(self.losses, self._sums / max(1, self._updates), strict=True)),
            **dict(zip(rewards, self._rewards / max(1, self._iterations), strict=True)),
            **self._other_metrics(),
        }
        metrics = self._read(parts)
        self._restart_metrics()
        return metrics

    def _other_metrics(self) -> dict[str, Tensor]:
        return {}

    def _restart_metrics(self) -> None:
        self._updates = self._iterations = 0
        sums = self._sums, self._rewards, self._episodes.totals
        for value in (*sums, *(optimizer.norms for optimizer in self.optimizers)):
            value.zero_()

    @torch.no_grad()
    def _follow(self, rate: float) -> None:
        """Take a step of the target networks towards the networks, in place."""
        targets = [x for target in self.targets for x in target.parameters()]
        own = [x for name in self.followed for x in getattr(self.agent, name).parameters()]
        torch._foreach_lerp_(targets, own, rate)

    def _tensors(self) -> dict[str, list[Tensor]]:
        return {
            "target": [x for target in self.targets for x in target.parameters()],
            "optimizers": [x for optimizer in self.optimizers for x in optimizer.state()],
        }

    def state_dict(self) -> dict[str, Any]:
        replay = {"replay": copies(self.replay.state())} if self._keeps_replay else {}
        return {**super().state_dict(), **replay, "held": self._held}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self._held = state["held"]
        if self._keeps_replay and "replay" in state:
            restore(self.replay.state(), state["replay"])
        else:
            self.replay.clear()
            self._held = 0
