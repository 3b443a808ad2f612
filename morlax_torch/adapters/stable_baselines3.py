"""N worlds under one trade-off as a Stable-Baselines3 VecEnv, in numpy."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from ..envs import MorlaxError
from ..envs.errors import require
from .episode_statistics import EpisodeStatistics
from .gymnasium import GymnasiumVectorEnv, check_options

require("Stable-Baselines3", "stable-baselines3", "2.7", "sb3")

from stable_baselines3.common.vec_env import VecEnv


class StableBaselines3VecEnv(VecEnv):
    """N worlds of a task, whose reward (N,) is the objectives weighted by `tradeoff`.

    The info of each world holds "vector_reward" (m,) and "TimeLimit.truncated". If its episode
    ended, it also holds "terminal_observation" (O,) and "episode": the return "r", length "l" in
    control steps, wall-clock time "t" in seconds and "returns" (m,) of the objectives.
    Stable-Baselines3 logs episodes from it without a Monitor.

    The worlds are one batch: they share their attributes, which cannot be set, and single worlds
    cannot be wrapped.

    Args:
        task, tradeoff, num_envs, device, backend, options: as for `GymnasiumVectorEnv`;
            `VecVideoRecorder` needs render_mode="rgb_array".
    """

    def __init__(
        self,
        task: str,
        tradeoff: Sequence[float],
        num_envs: int = 64,
        device: str | torch.device | None = None,
        backend: str | None = None,
        **options: Any,
    ):
        self.vector = GymnasiumVectorEnv(task, num_envs, device, backend, tradeoff, **options)
        self._statistics = EpisodeStatistics(self.vector)
        self._tradeoff = np.asarray(tradeoff, dtype=np.float32)
        super().__init__(
            num_envs, self.vector.single_observation_space, self.vector.single_action_space
        )
        self.metadata = self.vector.metadata  # it has the frame rate of videos

    def reset(self) -> NDArray[np.float32]:
        """Reset every world; returns the observation (N, O).

        The first seed set by `seed` seeds all worlds.
        """
        observation, _ = self._statistics.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observation.cpu().numpy()

    def set_options(self, options: list[dict] | dict | None = None) -> None:
        """Check that there are no options: resets take none."""
        for each in options if isinstance(options, list) else [options]:
            check_options(each)

    def step_async(self, actions: NDArray) -> None:
        """Store actions (N, A) in [-1, 1] for `step_wait`; they must be finite."""
        if not np.isfinite(actions).all():
            raise MorlaxError("actions must be finite, but these contain a NaN or an infinity.")
        self._actions = np.ascontiguousarray(actions)

    def step_wait(self) -> tuple[NDArray, NDArray, NDArray, list[dict[str, Any]]]:
        """Advance every world by one control step under the stored actions.

        Returns the observation (N, O), reward (N,), done (N,) and N infos.
        """
        actions = torch.as_tensor(self._actions, device=self.vector.device)
        observation, reward, terminated, truncated, info = self._statistics.step(actions)
        done = (terminated | truncated).cpu().numpy()
        timed_out = (truncated & ~terminated).cpu().numpy()
        objectives = info["vector_reward"].cpu().numpy()
        infos: list[dict[str, Any]] = [
            {"TimeLimit.truncated": over, "vector_reward": vector_reward}
            for over, vector_reward in zip(timed_out.tolist(), objectives, strict=True)
        ]
        if done.any():
            final = info["final_obs"].cpu().numpy()
            episode = {name: values.cpu().numpy() for name, values in info["episode"].items()}
            for world in done.nonzero()[0]:
                infos[world]["terminal_observation"] = final[world]
                returns, length, time = (episode[name][world] for name in ("r", "l", "t"))
                weighted = {"r": float(returns @ self._tradeoff), "returns": returns}
                infos[world]["episode"] = weighted | {"l": int(length), "t": float(time)}
        return observation.cpu().numpy(), reward.cpu().numpy(), done, infos

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return an image of each world, which `render` tiles; none without a render mode."""
        return self.vector.render() or ()

    def close(self) -> None:
        self.vector.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the attribute of the batch, once per requested world."""
        return [getattr(self.vector, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise MorlaxError(f"{attr_name} cannot be set: pass options to the constructor.")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        raise MorlaxError(f"{method_name} cannot be called on one world: use `env.vector`.")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        """Return False for each requested world."""
        return [False for _ in self._get_indices(indices)]
