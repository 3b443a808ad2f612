"""One world as a Gymnasium environment in numpy, with pictures and a window in real time."""

import time
import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from .. import envs
from ..envs import MorlaxError, Robot
from ..envs.errors import shortened
from ..viewers.camera import FollowingCamera
from ..viewers.filming.rendering import Scene
from .checking import OneTask, box


class Pictures:
    """Draws a robot. It opens OpenGL with the first picture."""

    def __init__(self, robot: Robot, width: int, height: int):
        model = robot.physics.model
        self.data = mujoco.MjData(model)
        self._model, self._size = model, (width, height)
        self._scene: Scene | None = None
        # all pictures share the camera's distance, which is chosen by the model's own pose
        mujoco.mj_forward(model, self.data)
        self._camera = FollowingCamera(model, width / height, base=robot.base)
        self._camera.restart(self.data)

    def pose(self, qpos: Tensor, qvel: Tensor) -> mujoco.MjData:
        """Put the robot into a state, qpos (nq,) and qvel (nv,); returns `data`."""
        self.data.qpos[:] = qpos.cpu().numpy()
        self.data.qvel[:] = qvel.cpu().numpy()
        mujoco.mj_forward(self._model, self.data)
        return self.data

    def draw(self, qpos: Tensor, qvel: Tensor) -> NDArray[np.uint8]:
        """Return a picture of the robot in a state, (height, width, 3) RGB."""
        if self._scene is None:
            self._scene = Scene(self._model, *self._size)
        data, camera = self.pose(qpos, qvel), self._camera.camera
        camera.lookat[:] = data.subtree_com[self._camera.base]
        return self._scene.draw(data, camera)

    def close(self) -> None:
        """Free the renderer."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None


class Window:
    """MuJoCo's passive viewer, which shows a state that its caller changes in place every dt s."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, dt: float):
        import glfw
        import mujoco.viewer

        # check first: MuJoCo's viewer would fail in its own thread while its caller waits forever
        with warnings.catch_warnings(action="ignore"):
            has_screen = glfw.init()
        if not has_screen:
            raise MorlaxError("there is no screen here: use 'rgb_array'.")
        try:
            self._viewer = mujoco.viewer.launch_passive(
                model, data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:  # macOS opens windows only under mjpython
            raise MorlaxError(f"MuJoCo cannot open a window here: {error}.") from None
        self._dt, self._due = dt, time.monotonic()

    def show(self) -> None:
        """Show the current state of `data`, at least `dt` seconds after the previous call."""
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due, time.monotonic()) + self._dt
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


class GymnasiumEnv(OneTask, gymnasium.Env, EzPickle):
    """One world on C MuJoCo, as made by `gymnasium.make("morlax_torch/Ant-v0")`.

    The reward is a vector (m,), as in MO-Gymnasium. With a `tradeoff`, the reward is the weighted
    sum of the objectives, one number as in Gymnasium, and `info["vector_reward"]` (m,) holds the
    objectives.

    The world truncates its own episodes after `episode_length` control steps (a task option).
    `worlds` is the underlying morlax_torch environment. An unpickled copy starts from scratch.

    Args:
        task: one of `envs.names()`; a Gymnasium id sets it already.
        tradeoff: (m,), not negative; used as given, so it need not sum to one.
        render_mode: "rgb_array" for images from `render`, "human" for a window that updates
            itself in real time, or None.
        width: image width in pixels.
        height: image height in pixels.
        model_seed: random seed of what resets leave: a randomized model, and the states among which
            noisy starts are drawn.
        task_options: as for `envs.make`, for example `reset_noise=0.01`.

    Raises:
        MorlaxError: an unknown option or render mode, or an invalid trade-off.
    """

    metadata = {"render_modes": ["human", "rgb_array"]}

    def __init__(
        self,
        task: str,
        tradeoff: Sequence[float] | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        model_seed: int = 0,
        **task_options: Any,
    ):
        EzPickle.__init__(
            self, task, tradeoff, render_mode, width, height, model_seed, **task_options
        )
        self._check(task, task_options, render_mode)
        self.worlds = worlds = envs.make_robot(task, model_seed, **task_options)
        self.metadata = {**self.metadata, "render_fps": round(1 / worlds.dt)}
        self.render_mode = render_mode
        self.observation_space = box(worlds.observation_size)
        self.action_space = box(worlds.action_size, 1.0)
        self.reward_dim = len(worlds.objectives)
        self._show(worlds, tradeoff)
        self._pictures = Pictures(worlds, width, height)
        self._window: Window | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start a new episode; returns the observation (O,) and an empty info.

        `seed` is the random seed of the world from here on. Without one, the first reset picks a
        random seed and later resets continue its random draws. `options` must be empty.
        """
        super().reset(seed=seed)
        observation = self._restart(seed, options)[0].numpy()
        if self.render_mode == "human":
            self.render()
        return observation, {}

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Advance the world by one control step under an action (A,) in [-1, 1].

        Raises:
            MorlaxError: an invalid action, or `reset` was never called.
        """
        step = self.worlds.step(self._checked(action)[None])
        reward, info = step.reward[0].numpy(), {}
        if self._weights is not None:
            info["vector_reward"] = reward
            reward = (step.reward[0] * self._weights).sum().item()
        if self.render_mode == "human":
            self.render()
        observation = step.observation[0].numpy()
        return observation, reward, bool(step.terminated), bool(step.truncated), info

    def render(self) -> NDArray[np.uint8] | None:
        """Return an image of the robot, (height, width, 3) RGB, or update the window.

        The result is None in "human" mode and without a render mode.

        Raises:
            MorlaxError: `reset` was never called, or there is no OpenGL or no screen.
        """
        if self.render_mode is None:
            return None
        self._check_reset("render")
        physics = self.worlds.physics
        state = physics.qpos[0], physics.qvel[0]
        if self.render_mode == "rgb_array":
            return self._pictures.draw(*state)
        data = self._pictures.pose(*state)
        self._window = self._window or Window(physics.model, data, self.worlds.dt)
        return self._window.show()

    def close(self) -> None:
        """Close the window and free the renderer."""
        self._pictures.close()
        if self._window is not None:
            self._window.close()
        self._window = None

    def _checked(self, action: ArrayLike) -> torch.Tensor:
        self._check_reset("step")
        size = self.worlds.action_size
        action = action.detach() if isinstance(action, torch.Tensor) else action
        try:
            numbers = np.ascontiguousarray(action, np.float32)
        except (TypeError, ValueError):  # a tensor on the GPU, ragged rows, strings
            numbers = np.empty(0)
        if numbers.shape != (size,) or not np.isfinite(numbers).all():
            raise MorlaxError(f"an action is of {size} finite numbers, not {shortened(action)}.")
        return torch.tensor(numbers)
