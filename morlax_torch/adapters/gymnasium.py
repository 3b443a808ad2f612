"""The tasks as Gymnasium environments: one world in numpy, or N worlds in torch tensors."""

import secrets
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from .. import envs
from ..configuration.tradeoffs import one_tradeoff
from ..envs import MorlaxError, Robot, Worlds
from ..envs.errors import shortened, unknown
from ..envs.worlds import checks
from ..envs.worlds.trees import forwarded
from ..gpu.graph import Graph
from ..host.resources import one_thread
from ..viewers.camera import FollowingCamera
from ..viewers.filming.rendering import Scene, check_size
from ..viewers.window import open_window


def box(size: int, limit: float = np.inf) -> gymnasium.spaces.Box:
    """Return the space of `size` numbers in [-limit, limit] of one world."""
    return gymnasium.spaces.Box(-limit, limit, (size,), np.float32)


def check_options(options: dict[str, Any] | None) -> None:
    """Raise MorlaxError if there are options of a reset."""
    if options:
        raise MorlaxError(f"reset takes no options, but got {shortened(options)}.")


class UnknownOption(MorlaxError, TypeError):
    """An unknown option, also in Python's own words for an unexpected keyword argument.

    TorchRL's `GymEnv` first tries an option `frameskip`, and goes on after a TypeError in these.
    """


class Pictures:
    """Draws a robot, or shows it in a window. It opens either with the first picture."""

    def __init__(self, robot: Robot, width: int, height: int):
        check_size(width, height)
        model = robot.physics.model
        self._model, self._data, self._dt = model, forwarded(model), robot.dt
        self._size = width, height
        self._scene: Scene | None = None
        self._viewer: Any = None
        # all pictures share the camera's distance, which is chosen by the model's own pose
        self._camera = FollowingCamera(model, width / height, base=robot.base)
        self._camera.restart(self._data)

    def draw(self, qpos: Tensor, qvel: Tensor) -> NDArray[np.uint8]:
        """Return a picture of a state, qpos (nq,) and qvel (nv,): (height, width, 3) RGB."""
        if self._scene is None:
            self._scene = Scene(self._model, *self._size)
        self._pose(qpos, qvel)
        camera = self._camera.camera
        camera.lookat[:] = self._data.subtree_com[self._camera.base]
        return self._scene.draw(self._data, camera)

    def show(self, qpos: Tensor, qvel: Tensor) -> None:
        """Show a state in MuJoCo's passive viewer, a control step after the previous one."""
        self._pose(qpos, qvel)
        if self._viewer is None:
            scene, remedy = (self._model, self._data), "use 'rgb_array'"
            self._viewer = open_window(*scene, remedy, show_right_ui=False)
            self._due = time.monotonic()
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due, time.monotonic()) + self._dt
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window and free the renderer."""
        for opened in filter(None, (self._scene, self._viewer)):
            opened.close()
        self._scene = self._viewer = None

    def _pose(self, qpos: Tensor, qvel: Tensor) -> None:
        self._data.qpos[:] = qpos.cpu().numpy()
        self._data.qvel[:] = qvel.cpu().numpy()
        mujoco.mj_forward(self._model, self._data)


class OneTask:
    """What one world and N worlds of a task as Gymnasium environments share."""

    worlds: Worlds
    metadata: dict[str, Any]
    _spec: EnvSpec | None = None
    np_random: np.random.Generator  # Gymnasium's, which draws the seed of the worlds
    _weights: Tensor | None = None  # (m,)
    _pictures: Pictures | None = None
    _was_reset = False

    @property
    def spec(self) -> EnvSpec | None:
        """How to make this environment again; None if Gymnasium did not make it."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        # The registered spec has no time limit, or Gymnasium would wrap this in a second one.
        self._spec = spec and replace(spec, max_episode_steps=self.worlds.episode_length)

    def _check(self, task: str, options: dict[str, Any], render_mode: str | None) -> None:
        """Check the names of the render mode and of a task's options, not the options' values."""
        modes, fields = self.metadata["render_modes"], envs.get(task).Options.model_fields
        if render_mode not in (None, *modes):
            raise unknown("render mode", render_mode, modes)
        for name in options:
            if name not in fields:
                words = f"{task} got an unexpected keyword argument {name!r}"
                raise UnknownOption(f"{unknown('option', name, fields)} ({words})")
        self.render_mode = render_mode

    def _show(self, tradeoff: Sequence[float] | None, width: int, height: int) -> None:
        worlds, objectives = self.worlds, self.worlds.objectives
        self.objectives, self.reward_space = objectives, box(len(objectives))
        if tradeoff is not None:
            self.reward_space = None  # each reward is one number
            self._weights = one_tradeoff(tradeoff, objectives, worlds.device)
        self.metadata = {**self.metadata, "render_fps": round(1 / worlds.dt)}
        if self.render_mode is not None:
            if not isinstance(worlds, Robot):
                raise MorlaxError("these worlds are not drawn together: leave out render_mode.")
            self._pictures = Pictures(worlds, width, height)

    def _restart(self, seed: int | None, options: dict[str, Any] | None) -> Tensor:
        """Reset the worlds after Gymnasium's own part; returns the observation (N, O)."""
        check_options(options)
        if seed is not None or not self._was_reset:
            self.worlds.reseed(int(self.np_random.integers(2**63)))
        self._was_reset = True
        return self.worlds.reset()

    def close_extras(self, **_: Any) -> None:
        """Close the window and free the renderer."""
        if self._pictures is not None:
            self._pictures.close()

    def _check_reset(self, call: str) -> None:
        if not self._was_reset:
            raise MorlaxError(f"{call} was called before reset: call reset first.")


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
        self.observation_space = box(worlds.observation_size)
        self.action_space = box(worlds.action_size, 1.0)
        self.reward_dim = len(worlds.objectives)
        self._show(tradeoff, width, height)

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
        self._check_reset("step")
        action = action.detach().float() if isinstance(action, Tensor) else action
        try:
            numbers = np.ascontiguousarray(action, np.float32)
        except (TypeError, ValueError):  # a tensor on the GPU, ragged rows, strings
            numbers = np.empty(0)
        if numbers.shape != self.action_space.shape or not np.isfinite(numbers).all():
            size = self.worlds.action_size
            raise MorlaxError(f"an action is of {size} finite numbers, not {shortened(action)}.")
        step = self.worlds.step(torch.tensor(numbers, device="cpu")[None])
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
        if self._pictures is None:
            return None
        self._check_reset("render")
        physics = self.worlds.physics
        state = physics.qpos[0], physics.qvel[0]
        if self.render_mode == "human":
            return self._pictures.show(*state)
        return self._pictures.draw(*state)

    def close(self) -> None:
        """Close the window and free the renderer."""
        self.close_extras()


class Stepping:
    """Steps worlds under a user's actions, on CUDA as a recorded graph."""

    def __init__(self, worlds: Worlds):
        self._worlds, self._device = worlds, worlds.device
        shape = worlds.num_worlds, worlds.action_size
        self._action = torch.zeros(shape, dtype=torch.float32, device=worlds.device)
        self._graph = Graph(self._advance, worlds.device, [worlds.generator])
        if worlds.recordable:
            self._graph.record()

    @torch.no_grad()
    def __call__(self, actions: Tensor | NDArray) -> tuple[Tensor, ...]:
        """Return the first five fields of a `TimeStep` under actions (N, A) of any values."""
        on_cpu = self._device.type == "cpu"
        if isinstance(actions, np.ndarray) and on_cpu and actions.dtype.kind in "biuf":
            actions = torch.from_numpy(np.array(actions, np.float32, order="C"))
        if not isinstance(actions, Tensor):
            raise MorlaxError(
                f"actions must be a torch tensor of numbers on {self._device}, not "
                f"{type(actions).__name__}: use torch.as_tensor(actions, device=envs.device), or "
                "wrap the environment in gymnasium.wrappers.vector.ArrayConversion."
            )
        checks.action(self._worlds, actions.float())
        self._action.copy_(actions)
        with one_thread(self._device):
            self._graph()
        # a replayed graph overwrites the same memory in every step
        return tuple(value.clone() for value in self._time_step[:5])

    def _advance(self) -> None:
        self._time_step = self._worlds.step(self._action)


class GymnasiumVectorEnv(OneTask, gymnasium.vector.VectorEnv):
    """N worlds, as made by `gymnasium.make_vec("morlax_torch/Ant-v0", num_envs=4096)`.

    Everything is a torch tensor on `device`, and no method but `render` forces a GPU sync. A world
    whose episode ends starts the next one in the same step (`AutoresetMode.SAME_STEP`). `info` has
    the layout of Gymnasium's `SyncVectorEnv`, but is complete in every step: `final_obs` (N, O)
    holds the observations before any reset, and the mask `_final_obs` (N,) marks the worlds whose
    episode ended.

    Rewards are (N, m). With a `tradeoff` they are (N,), the weighted sum of the objectives, and
    `info["vector_reward"]` (N, m) holds the objectives. `reward_space` is that of one world, or
    None with a `tradeoff`. `worlds` is the underlying morlax_torch environment.

    Args:
        task, tradeoff, width, height, task_options: as for `GymnasiumEnv`.
        num_envs: N.
        device, backend: as for `envs.make`.
        render_mode: "rgb_array" for images from `render`, or None.
        max_episode_steps: Gymnasium's name for the option `episode_length`.
        model_seed: as for `GymnasiumEnv`; None picks one at random.

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
        task_options = {"stagger": False, **task_options}  # mjlab's tasks have another default
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
        self._show(tradeoff, width, height)
        self._stepping = Stepping(worlds)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Reset every world; returns the observation (N, O) and an empty info.

        Arguments are those of `GymnasiumEnv.reset`. N seeds together make one seed for all worlds,
        so the draws of each world depend on all of them.
        """
        if isinstance(seed, Sequence | np.ndarray):
            seed = _one_seed(seed, self.num_envs)
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


def _one_seed(seeds: Sequence[int], number: int) -> int:
    """Mix the seeds of N worlds into one, because one generator draws for all of them."""
    with suppress(TypeError, ValueError):
        if len(seeds) == number:
            return int(np.random.SeedSequence(seeds).generate_state(1, np.uint64)[0])
    needed = f"an integer from 0, or one for each of the {number} worlds"
    raise MorlaxError(f"the seed of reset must be {needed}, not {shortened(seeds)}.")
