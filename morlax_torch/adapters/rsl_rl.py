"""N worlds under one trade-off as an rsl_rl VecEnv, in tensors on the device."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..envs.errors import require
from .episode_statistics import EpisodeStatistics
from .gymnasium import GymnasiumVectorEnv

require("rsl_rl", "rsl-rl-lib", "3.0", "rsl-rl")

from rsl_rl.env import VecEnv
from tensordict import TensorDict


class Arguments(dict[str, Any]):
    """The arguments of an environment. rsl_rl's log writers want them from `to_dict`."""

    def to_dict(self) -> dict[str, Any]:
        return dict(self)


class RslRlVecEnv(VecEnv):
    """N worlds of a task, whose reward (N,) is the objectives weighted by `tradeoff`.

    The observation group "policy" is (N, O). If the task has privileged features, the group
    "critic" is (N, O + P). Actions are clipped to [-1, 1], since rsl_rl's policies are unbounded.

    The extras of a step hold "time_outs" (N,), which lets rsl_rl tell a time limit from a failure;
    "objectives" (N, m), the reward of each objective; and, if episodes ended, "log", the returns
    of these episodes per objective.

    `cfg` holds the arguments of the environment, for rsl_rl to log. `step_dt` is the length of a
    control step in seconds (1 if it is unknown), by which rsl_rl's RND scales its weight.

    Args:
        task, tradeoff, num_envs, backend, task_options: as for `GymnasiumVectorEnv`.
        device: as for `envs.make`; pass the same one to the runner.
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
        self._statistics = EpisodeStatistics(self.vector)
        self._worlds = worlds = self.vector.worlds
        self.num_envs, self.num_actions = num_envs, worlds.action_size
        self.device, self.max_episode_length = worlds.device, worlds.episode_length
        self.cfg = Arguments(task=task, tradeoff=list(tradeoff), num_envs=num_envs, **task_options)
        self.step_dt = worlds.dt if math.isfinite(worlds.dt) else 1.0
        self._observation, _ = self._statistics.reset(seed=seed)

    @property
    def unwrapped(self) -> "RslRlVecEnv":
        """This environment, in which rsl_rl's RND finds `step_dt`."""
        return self

    @property
    def episode_length_buf(self) -> Tensor:
        """Control steps of each world's current episode, (N,); writable, to shift time limits."""
        return self._worlds.age

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:
        self._worlds.age.copy_(steps)

    def get_observations(self) -> TensorDict:
        """Return the current observations by group."""
        groups = {"policy": self._observation}
        if self._worlds.privileged_size:
            groups["critic"] = self._worlds.critic_observation()
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Advance every world by one control step under actions (N, A).

        Returns observations by group, rewards (N,), dones (N,) and extras.
        """
        result = self._statistics.step(actions.clamp(-1, 1))
        self._observation, reward, terminated, truncated, info = result
        done = terminated | truncated
        extras: dict[str, Any] = {"time_outs": truncated & ~terminated}
        extras["objectives"] = info["vector_reward"]
        if done.any():  # a GPU sync, but rsl_rl syncs here anyway to sum up episodes
            returns = info["episode"]["r"][done].unbind(-1)
            names = (f"Return/{name}" for name in self.vector.objectives)
            extras["log"] = dict(zip(names, returns, strict=True))
        return self.get_observations(), reward, done.long(), extras
