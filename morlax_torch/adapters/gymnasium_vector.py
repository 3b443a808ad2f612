"""N worlds as a Gymnasium vector environment, in torch tensors."""

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
    """N worlds, as made by `gymnasium.make_vec("morlax_torch/Ant-v0", num_envs=4096)`.

    Everything is a torch tensor on `device`, and no method forces a GPU sync. A world whose
    episode ends starts the next one in the same step (`AutoresetMode.SAME_STEP`). `info` has the
    layout of Gymnasium's `SyncVectorEnv`, but is complete in every step: `final_obs` (N, O) holds
    the observations before any reset, and the mask `_final_obs` (N,) marks the worlds whose
    episode ended.

    Rewards are (N, m). With a `tradeoff` they are (N,), the weighted sum of the objectives, and
    `info["vector_reward"]` (N, m) holds the objectives.

    `reward_space` is the reward space of one world. `worlds` is the underlying morlax_torch
    environment.

    Args:
        task: one of `envs.names()`; a Gymnasium id sets it already.
        num_envs: N.
        device: as for `envs.make`.
        backend: as for `envs.make`.
        tradeoff: (m,), not negative; used as given, so it need not sum to one.
        task_options: as for `envs.make`, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown option, a missing device, or an invalid trade-off.
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
        self._was_reset = False
        self._action = torch.zeros(num_envs, worlds.action_size, device=worlds.device)
        self._time_step: TimeStep | None = None
        self._advance = Graph(self._one_step, worlds.device, [worlds.generator])
        if worlds.recordable:
            self._advance.record()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Reset every world; returns the observation (N, O) and an empty info.

        Args:
            seed: random seed of the worlds from here on. Without one, the first reset picks a
                random seed and later resets continue its random draws.
            options: not supported; must be empty or None.

        Raises:
            MorlaxError: `options` is not empty.
        """
        super().reset(seed=seed)
        prepare(self.worlds, self.np_random, options, draw=seed is not None or not self._was_reset)
        self._was_reset = True
        return self.worlds.reset(), {}

    @torch.no_grad()
    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance every world by one control step.

        Values are not checked for being finite, since the check would force a GPU sync. A world
        that receives a NaN returns a NaN reward or ends its episode; the other worlds are
        unaffected.

        Args:
            actions: (N, A) in [-1, 1], on the device of the worlds.

        Raises:
            MorlaxError: actions of another shape or device, or `reset` was never called.
        """
        self._check(actions)
        self._action.copy_(actions)
        with one_thread(self.device):
            self._advance()
        assert self._time_step is not None
        # a replayed graph overwrites the same memory in every step
        observation, reward, terminated, truncated, final = (x.clone() for x in self._time_step[:5])
        done = terminated | truncated
        info: dict[str, Any] = {"final_obs": final, "_final_obs": done}
        info |= {"final_info": {}, "_final_info": done}
        if self._weights is not None:
            info |= {"vector_reward": reward, "_vector_reward": torch.ones_like(done)}
            info["final_info"] = {"vector_reward": reward, "_vector_reward": done}
            reward = (reward * self._weights).sum(-1)
        return observation, reward, terminated, truncated, info

    def _one_step(self) -> None:
        self._time_step = self.worlds.step(self._action)

    def _check(self, actions: Tensor) -> None:
        if not self._was_reset:
            raise MorlaxError("step was called before reset: call reset first.")
        check_actions(actions, self._action.shape, self.device)
