"""N worlds as a vector environment of Gymnasium, in torch tensors."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from .. import envs
from ..envs import MorlaxError, TimeStep
from ..gpu.graph import Graph
from ..gpu.threads import one_thread
from ..tradeoffs import one_tradeoff
from .actions import check_actions
from .resetting import prepare


class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):
    """What `gymnasium.make_vec("morlax_torch/Ant-v0", num_envs=4096)` makes.

    Everything is a torch tensor on `device`, and nothing waits for a GPU. A world whose episode
    ends begins the next one in the same step (`AutoresetMode.SAME_STEP`). `info` has the layout
    of Gymnasium's own `SyncVectorEnv`, but in every step: `final_obs` (N, O) is what was seen
    before any reset and the mask `_final_obs` (N,) says whose episode ended.

    Rewards are (N, m). With a `tradeoff` they are (N,), the sum of the objectives weighted by it,
    and `info["vector_reward"]` (N, m) holds the objectives.

    `reward_space` is what one world pays; `worlds` is our own environment underneath.

    Args:
        task: a name of `envs.names()`; an id already says which.
        num_envs: N.
        device: as for `envs.make`.
        backend: likewise.
        tradeoff: (m,) not negative; used as it is, so it need not sum to one.
        task_options: likewise, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown option, no such device, or a trade-off that is none.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        device: str | torch.device | None = None,
        backend: str | None = None,
        tradeoff: Sequence[float] | None = None,
        **task_options: Any,
    ):
        self.worlds = worlds = envs.make(task, num_envs, device, backend, **task_options)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.num_envs, self.device, self.objectives = num_envs, worlds.device, worlds.objectives
        self.single_observation_space = worlds.observation_space
        self.single_action_space = worlds.action_space
        self.observation_space = batch_space(worlds.observation_space, num_envs)
        self.action_space = batch_space(worlds.action_space, num_envs)
        self.reward_space = worlds.reward_space
        self._weights = None
        if tradeoff is not None:
            self._weights = one_tradeoff(tradeoff, worlds.objectives, worlds.device)
        self._begun = False
        self._action = torch.zeros(num_envs, worlds.action_size, device=worlds.device)
        self._made: TimeStep | None = None
        self._advance = Graph(self._one_step, worlds.device, [worlds.generator])
        self._advance.record()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start every world anew: the observation (N, O), and no info.

        Args:
            seed: of whatever the worlds draw from here on; without one in the first reset they
                draw by chance.
            options: none are known.

        Raises:
            MorlaxError: there are options.
        """
        super().reset(seed=seed)
        prepare(self.worlds, self.np_random, options, draw=seed is not None or not self._begun)
        self._begun = True
        return self.worlds.reset(), {}

    @torch.no_grad()
    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """One control step under actions (N, A) in [-1, 1], which lie on the device.

        Whether they are finite is not looked at, because that would wait for the GPU: a world
        that is given a NaN pays NaN, or ends its episode; the others do not notice.

        Raises:
            MorlaxError: actions of another shape or device, or no reset before.
        """
        self._check(actions)
        self._action.copy_(actions)
        with one_thread(self.device):
            self._advance()
        assert self._made is not None
        # a replayed graph writes the same memory in every step
        observation, reward, terminated, truncated, final = (x.clone() for x in self._made[:5])
        done = terminated | truncated
        info: dict[str, Any] = {"final_obs": final, "_final_obs": done}
        info |= {"final_info": {}, "_final_info": done}
        if self._weights is not None:
            info |= {"vector_reward": reward, "_vector_reward": torch.ones_like(done)}
            info["final_info"] = {"vector_reward": reward, "_vector_reward": done}
            reward = (reward * self._weights).sum(-1)
        return observation, reward, terminated, truncated, info

    def _one_step(self) -> None:
        self._made = self.worlds.step(self._action)

    def _check(self, actions: Tensor) -> None:
        if not self._begun:
            raise MorlaxError("step was called before reset: call reset first.")
        check_actions(actions, self._action.shape, self.device)
