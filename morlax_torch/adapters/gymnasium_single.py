"""One world as an environment of Gymnasium, in numpy, that can be looked at."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from .. import envs
from ..envs import MorlaxError
from ..envs.errors import unknown
from ..tradeoffs import one_tradeoff
from ..viewers.filming.rendering import Scene
from .resetting import prepare
from .window import Window


class GymnasiumEnv(gymnasium.Env, EzPickle):
    """What `gymnasium.make("morlax_torch/Ant-v0")` makes: one world on C MuJoCo.

    Rewards are (m,), which follows MO-Gymnasium's conventions. With a `tradeoff` a reward is one
    number, the sum of the objectives weighted by it, which follows Gymnasium's, and
    `info["vector_reward"]` (m,) holds the objectives.

    Episodes end by themselves after `episode_length` control steps (a task option). `worlds` is
    our own environment underneath. A copy by pickle starts anew.

    Args:
        task: a name of `envs.names()`; an id already says which.
        tradeoff: (m,) not negative; used as it is, so it need not sum to one.
        render_mode: "rgb_array" for pictures from `render`, "human" for a window that follows
            by itself in real time, or None.
        width: of the pictures, in pixels.
        height: likewise.
        task_options: as for `envs.make`, for example `reset_noise=0.01`.

    Raises:
        MorlaxError: an unknown option or render mode, or a trade-off that is none.
    """

    metadata = {"render_modes": ["human", "rgb_array"]}

    def __init__(
        self,
        task: str,
        tradeoff: Sequence[float] | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        **task_options: Any,
    ):
        EzPickle.__init__(self, task, tradeoff, render_mode, width, height, **task_options)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise unknown("render mode", render_mode, self.metadata["render_modes"])
        self.worlds = worlds = envs.make_robot(task, **task_options)
        self.metadata = {**self.metadata, "render_fps": round(1 / worlds.dt)}
        self.render_mode, self.objectives = render_mode, worlds.objectives
        self.observation_space, self.action_space = worlds.observation_space, worlds.action_space
        self.reward_space, self.reward_dim = worlds.reward_space, len(worlds.objectives)
        self._weights = None
        if tradeoff is not None:
            self._weights = one_tradeoff(tradeoff, worlds.objectives, worlds.device)
        self._size = width, height
        self._data = mujoco.MjData(worlds.physics.model)
        self._scene: Scene | None = None
        self._window: Window | None = None
        self._begun = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode: the observation (O,), and no info.

        Args:
            seed: of whatever the world draws from here on; without one in the first reset it
                draws by chance.
            options: none are known.

        Raises:
            MorlaxError: there are options.
        """
        super().reset(seed=seed)
        prepare(self.worlds, self.np_random, options, draw=seed is not None or not self._begun)
        self._begun = True
        observation = self.worlds.reset()[0].numpy()
        if self.render_mode == "human":
            self.render()
        return observation, {}

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """One control step under an action (A,) in [-1, 1].

        Raises:
            MorlaxError: an action that is none, or no reset before.
        """
        step = self.worlds.step(self._checked(action)[None])
        reward, info = step.reward[0], {}
        if self._weights is not None:
            info["vector_reward"] = reward.numpy()
            reward = (reward * self._weights).sum().item()
        else:
            reward = reward.numpy()
        if self.render_mode == "human":
            self.render()
        observation = step.observation[0].numpy()
        return observation, reward, bool(step.terminated), bool(step.truncated), info

    def render(self) -> NDArray[np.uint8] | None:
        """The robot as it stands, (height, width, 3) RGB; in "human" mode the window shows it.

        Raises:
            MorlaxError: no render mode was asked for, no reset was before, or there is no OpenGL
                or no screen.
        """
        if self.render_mode is None:
            raise MorlaxError(
                "nothing is drawn without a render mode: make the environment with "
                "render_mode='rgb_array', or 'human' for a window."
            )
        self._check_begun("render")
        physics = self.worlds.physics
        self._data.qpos[:] = physics.qpos[0].numpy()
        self._data.qvel[:] = physics.qvel[0].numpy()
        mujoco.mj_forward(physics.model, self._data)
        if self.render_mode == "human":
            self._window = self._window or Window(physics.model, self._data, self.worlds.dt)
            return self._window.show()
        self._scene = self._scene or Scene(physics.model, *self._size)
        return self._scene.draw(self._data)

    def close(self) -> None:
        """Close the window, or free what draws pictures."""
        for open_one in (self._scene, self._window):
            if open_one is not None:
                open_one.close()
        self._scene = self._window = None

    def _check_begun(self, call: str) -> None:
        if not self._begun:
            raise MorlaxError(f"{call} was called before reset: call reset first.")

    def _checked(self, action: ArrayLike) -> torch.Tensor:
        self._check_begun("step")
        size = self.worlds.action_size
        try:
            numbers = np.asarray(action, dtype=np.float32)
        except (TypeError, ValueError):  # a GPU's tensor, rows of unequal length, words
            raise MorlaxError(
                f"an action is a numpy array of {size} numbers, but this is a "
                f"{type(action).__name__} that numpy cannot read."
            ) from None
        if numbers.shape != (size,):
            raise MorlaxError(f"an action needs the shape {(size,)}, but has {numbers.shape}.")
        if not np.isfinite(numbers).all():
            raise MorlaxError("an action must be finite, but this one holds a NaN or an infinity.")
        return torch.tensor(numbers)
