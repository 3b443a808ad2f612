"""N worlds under one trade-off as a wrapped environment of skrl, in tensors on the device."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from .episode_statistics import EpisodeStatistics
from .gymnasium_vector import GymnasiumVectorEnv
from .host import require

require("skrl", "skrl", "2.0", "skrl")

from skrl.envs.wrappers.torch import Wrapper


class SkrlEnv(Wrapper):
    """The task's worlds, whose reward (N, 1) is the objectives weighted by `tradeoff`.

    Actions are clipped to [-1, 1]. What the task has for critics alone is the state (N, O + P).
    In `info`, "vector_reward" (N, m) is what each objective paid, and after an episode's end
    "episode" the mean return of each objective, which skrl's trainers log.

    `vector` is the environment of Gymnasium underneath.

    Args:
        task: a name of `envs.names()`.
        tradeoff: (m,) not negative; used as it is, so it need not sum to one.
        num_envs: N.
        device: as for `envs.make`.
        backend: likewise.
        seed: of whatever the worlds draw; without one they draw by chance.
        task_options: likewise, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown task or option, no such device, or a trade-off that is none.
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
        self.vector = GymnasiumVectorEnv(task, num_envs, device, backend, tradeoff, **task_options)
        super().__init__(self.vector)
        self._statistics = EpisodeStatistics(self.vector)
        self._observation, _ = self._statistics.reset(seed=seed)

    @property
    def observation_space(self) -> gymnasium.Space:
        """What one world shows."""
        return self.vector.single_observation_space

    @property
    def action_space(self) -> gymnasium.Space:
        """What one world takes."""
        return self.vector.single_action_space

    @property
    def state_space(self) -> gymnasium.Space | None:
        """What one world shows critics, where that is more."""
        worlds = self.vector.worlds
        if not worlds.privileged_size:
            return None
        size = worlds.observation_size + worlds.privileged_size
        return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)

    def reset(self) -> tuple[Tensor, dict[str, Any]]:
        """What the worlds show now, (N, O); they start anew by themselves, each in its time."""
        return self._observation, {}

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """One control step under actions (N, A): (N, O), three times (N, 1), and info.

        Raises:
            MorlaxError: actions of another shape or device.
        """
        made = self._statistics.step(actions.clamp(-1, 1))
        self._observation, reward, terminated, truncated, info = made
        returns, done = info.pop("episode")["r"], info.pop("_episode")
        if done.any():
            means = returns[done].mean(0)
            names = (f"Return / {name}" for name in self.vector.objectives)
            info["episode"] = dict(zip(names, means, strict=True))
        columns = reward[:, None], terminated[:, None], truncated[:, None]
        return self._observation, *columns, info

    def state(self) -> Tensor | None:
        """What critics see now, (N, O + P), where that is more."""
        worlds = self.vector.worlds
        return worlds.critic_observation() if worlds.privileged_size else None

    def render(self, *_: Any, **__: Any) -> None:
        """Nothing is drawn."""

    def close(self) -> None:
        """Nothing is left open."""
        self.vector.close()
