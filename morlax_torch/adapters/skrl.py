"""N worlds under one trade-off as a wrapped skrl environment, in tensors on the device."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import torch
from torch import Tensor

from ..envs.errors import MorlaxError, require
from .episode_statistics import EpisodeStatistics
from .gymnasium import GymnasiumVectorEnv, box

require("skrl", "skrl", "2.0", "skrl")

from skrl.envs.wrappers.torch.gymnasium_envs import GymnasiumWrapper


class SkrlEnv(GymnasiumWrapper):
    """N worlds of a task, whose reward (N, 1) is the objectives weighted by `tradeoff`.

    Actions are clipped to [-1, 1]. If the task has privileged features, the state is (N, O + P).
    `info` holds "vector_reward" (N, m), the reward of each objective, and, if episodes ended,
    "episode", their mean return per objective, which skrl's trainers log. `reset` returns the
    current observation (N, O) and resets no world: each resets itself when its episode ends.

    `vector` is the underlying Gymnasium vector environment.

    Args:
        task, tradeoff, num_envs, device, backend, task_options: as for `GymnasiumVectorEnv`.
        seed: random seed of the worlds; None picks one at random.
    """

    def __init__(
        self,
        task: str,
        tradeoff: Sequence[float],
        num_envs: int = 64,
        device: str | torch.device | None = None,
        backend: str | None = None,
        seed: int | None = None,
        **task_options: Any,
    ):
        self.vector = GymnasiumVectorEnv(
            task, num_envs, device, backend, tradeoff, model_seed=seed, **task_options
        )
        super().__init__(self.vector)
        self._statistics = EpisodeStatistics(self.vector)
        # what skrl's wrapper returns from `reset`; its own first reset would take skrl's seed
        self._observation, self._info = self._statistics.reset(seed=seed)
        self._reset_once = False

    @property
    def state_space(self) -> gymnasium.Space | None:
        """The state space of one world, (O + P,); None without privileged features."""
        worlds = self.vector.worlds
        size = worlds.observation_size + worlds.privileged_size
        return box(size) if worlds.privileged_size else None

    def reset(self, **arguments: Any) -> tuple[Tensor, dict[str, Any]]:
        """Return the current observation (N, O) and an info; only `wrap_env` passes arguments."""
        if arguments:
            raise MorlaxError("SkrlEnv is a wrapper of skrl already: use it without wrap_env.")
        return super().reset()

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance every world by one control step under actions (N, A), without leaving the device.

        Returns the observation (N, O), reward (N, 1), terminated (N, 1), truncated (N, 1) and info.
        """
        result = self._statistics.step(actions.clamp(-1, 1))
        self._observation, reward, terminated, truncated, info = result
        returns, done = info.pop("episode")["r"], info.pop("_episode")
        if done.any():
            means = returns[done].mean(0)
            names = (f"Return / {name}" for name in self.vector.objectives)
            info["episode"] = dict(zip(names, means, strict=True))
        columns = reward[:, None], terminated[:, None], truncated[:, None]
        return self._observation, *columns, info

    def state(self) -> Tensor | None:
        """Return the current state (N, O + P) for critics; None without privileged features."""
        worlds = self.vector.worlds
        return worlds.critic_observation() if worlds.privileged_size else None
