"""N worlds as a Gymnasium vector environment, in torch tensors."""

import secrets
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from .. import envs
from ..envs import Environment, MorlaxError
from .checking import OneTask, Stepping, box, one_seed
from .gymnasium_single import Pictures


class GymnasiumVectorEnv(OneTask, gymnasium.vector.VectorEnv):
    """N worlds, as made by `gymnasium.make_vec("morlax_torch/Ant-v0", num_envs=4096)`.

    Everything is a torch tensor on `device`, and no method but `render` forces a GPU sync. A world
    whose episode ends starts the next one in the same step (`AutoresetMode.SAME_STEP`). `info` has
    the layout of Gymnasium's `SyncVectorEnv`, but is complete in every step: `final_obs` (N, O)
    holds the observations before any reset, and the mask `_final_obs` (N,) marks the worlds whose
    episode ended.

    Rewards are (N, m). With a `tradeoff` they are (N,), the weighted sum of the objectives, and
    `info["vector_reward"]` (N, m) holds the objectives.

    `reward_space` is the reward space of one world, or None with a `tradeoff`. `worlds` is the
    underlying morlax_torch environment.

    Args:
        task: one of `envs.names()`; a Gymnasium id sets it already.
        num_envs: N.
        device: as for `envs.make`.
        backend: as for `envs.make`.
        tradeoff: (m,), not negative; used as given, so it need not sum to one.
        render_mode: "rgb_array" for images from `render`, or None.
        width: image width in pixels.
        height: image height in pixels.
        max_episode_steps: Gymnasium's name for the option `episode_length`.
        model_seed: random seed of what resets leave: randomized models, and the states among which
            noisy starts are drawn; None picks one at random.
        task_options: as for `envs.make`, for example `episode_length=200`.

    Raises:
        MorlaxError: an unknown option or render mode, a missing device, an invalid trade-off, or
            images of a task without a MuJoCo robot.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": ["rgb_array"]}
    autoreset_mode = AutoresetMode.SAME_STEP

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        device: str | torch.device | None = None,
        backend: str | None = None,
        tradeoff: Sequence[float] | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        max_episode_steps: int | None = None,
        model_seed: int | None = 0,
        **task_options: Any,
    ):
        if max_episode_steps is not None:
            task_options = {"episode_length": max_episode_steps, **task_options}
        self._check(task, task_options, render_mode)
        seed = secrets.randbits(32) if model_seed is None else model_seed
        self.worlds = worlds = envs.make(task, num_envs, device, backend, seed, **task_options)
        self.num_envs, self.device = num_envs, worlds.device
        self.single_observation_space = box(worlds.observation_size)
        self.single_action_space = box(worlds.action_size, 1.0)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._show(worlds, tradeoff)
        self.render_mode = render_mode
        self._pictures: Pictures | None = None
        if render_mode is not None:
            if not isinstance(worlds, Environment):
                raise MorlaxError(f"{task} has no MuJoCo robot to draw: leave render_mode out.")
            self.metadata = {**self.metadata, "render_fps": round(1 / worlds.dt)}
            self._pictures = Pictures(worlds, width, height)
        self._stepping = Stepping(worlds)

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Tensor, dict[str, Any]]:
        """Reset every world; returns the observation (N, O) and an empty info.

        `seed` is the random seed of the worlds from here on. Without one, the first reset picks a
        random seed and later resets continue its random draws. N seeds together make one seed for
        all worlds, so the draws of each world depend on all of them. `options` must be empty.
        """
        if isinstance(seed, Sequence | np.ndarray):
            seed = one_seed(seed, self.num_envs)
        super().reset(seed=seed)
        return self._restart(seed, options).clone(), {}  # it may be the memory of the simulator

    def step(
        self, actions: Tensor | NDArray
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance every world by one control step.

        `actions` (N, A) in [-1, 1] are on the device of the worlds; on the CPU also an array.
        Values are not checked for being finite, since the check would force a GPU sync. A world
        that receives a NaN returns a NaN reward or ends its episode; the other worlds are
        unaffected.

        Raises:
            MorlaxError: actions of another shape or device, or `reset` was never called.
        """
        self._check_reset("step")
        observation, reward, terminated, truncated, final = self._stepping(actions)
        done = terminated | truncated
        info: dict[str, Any] = {"final_obs": final, "_final_obs": done}
        info |= {"final_info": {}, "_final_info": done}
        if self._weights is not None:
            info |= {"vector_reward": reward, "_vector_reward": torch.ones_like(done)}
            info["final_info"] = {"vector_reward": reward, "_vector_reward": done}
            reward = (reward * self._weights).sum(-1)
        return observation, reward, terminated, truncated, info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return an image of each world, (height, width, 3) RGB; None without a render mode.

        Raises:
            MorlaxError: `reset` was never called, or there is no OpenGL.
        """
        if self._pictures is None:
            return None
        self._check_reset("render")
        physics = self.worlds.physics
        return tuple(map(self._pictures.draw, physics.qpos.cpu(), physics.qvel.cpu()))

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """Call a method of the batch; skrl's `wrap_env` renders in this way."""
        return getattr(self, name)(*args, **kwargs)

    def close_extras(self) -> None:
        """Free the renderer."""
        if self._pictures is not None:
            self._pictures.close()
