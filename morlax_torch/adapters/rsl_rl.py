"""N worlds under one trade-off as a VecEnv of rsl_rl, in tensors on the device."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from .episode_statistics import EpisodeStatistics
from .gymnasium_vector import GymnasiumVectorEnv
from .host import require

require("rsl_rl", "rsl-rl-lib", "3.0", "rsl-rl")

from rsl_rl.env import VecEnv
from tensordict import TensorDict


class RslRlVecEnv(VecEnv):
    """The task's worlds, whose reward (N,) is the objectives weighted by `tradeoff`.

    The observation group "policy" is (N, O). Where the task has more for critics, "critic" is
    (N, O + P). Actions are clipped to [-1, 1], since rsl_rl's policies know no bounds.

    A step's extras hold "time_outs" (N,), by which rsl_rl tells a time limit from a failure,
    "objectives" (N, m), what each objective paid, and after an episode's end "log": the return of
    each objective over the episodes that ended.

    `cfg` says how the worlds were made, for rsl_rl to log.

    Args:
        task: a name of `envs.names()`.
        tradeoff: (m,) not negative; used as it is, so it need not sum to one.
        num_envs: N.
        device: as for `envs.make`; give the runner the same.
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
        self._statistics = EpisodeStatistics(self.vector)
        self._worlds = worlds = self.vector.worlds
        self.num_envs, self.num_actions = num_envs, worlds.action_size
        self.device, self.max_episode_length = worlds.device, worlds.episode_length
        self.cfg = {"task": task, "tradeoff": list(tradeoff), "num_envs": num_envs, **task_options}
        self._observation, _ = self._statistics.reset(seed=seed)

    @property
    def episode_length_buf(self) -> Tensor:
        """(N,) control steps of each world's episode so far; writing it moves their time limits."""
        return torch.as_tensor(self._worlds.age).long()

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:
        self._worlds.age[:] = steps.to(torch.int32)

    def get_observations(self) -> TensorDict:
        """What the worlds show now, by group."""
        groups = {"policy": self._observation}
        if self._worlds.privileged_size:
            groups["critic"] = self._worlds.critic_observation()
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """One control step under actions (N, A): what is seen, rewards (N,), dones (N,), extras.

        Raises:
            MorlaxError: actions of another shape or device.
        """
        made = self._statistics.step(actions.clamp(-1, 1))
        self._observation, reward, terminated, truncated, info = made
        done = terminated | truncated
        extras: dict[str, Any] = {
            "time_outs": truncated & ~terminated,
            "objectives": info["vector_reward"],
        }
        if done.any():  # rsl_rl itself waits for the GPU here, to sum up episodes
            returns = info["episode"]["r"][done].unbind(-1)
            names = (f"Return/{name}" for name in self.vector.objectives)
            extras["log"] = dict(zip(names, returns, strict=True))
        return self.get_observations(), reward, done.long(), extras
