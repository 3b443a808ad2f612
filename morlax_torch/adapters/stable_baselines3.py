"""N worlds under one trade-off as a VecEnv of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from ..envs import MorlaxError
from .episode_statistics import EpisodeStatistics
from .gymnasium_vector import GymnasiumVectorEnv
from .host import require

require("Stable-Baselines3", "stable-baselines3", "2.7", "sb3")

from stable_baselines3.common.vec_env import VecEnv


class StableBaselines3VecEnv(VecEnv):
    """The task's worlds, in numpy, whose reward (N,) is the objectives weighted by `tradeoff`.

    Each world's info holds "vector_reward" (m,), and "TimeLimit.truncated"; where an episode has
    ended also "terminal_observation" (O,) and "episode": return "r", steps "l", seconds "t" and
    "returns" (m,) of the objectives. No Monitor is needed for Stable-Baselines3 to log episodes.

    The worlds are one batch: an attribute is the same for all of them and cannot be set, and no
    wrapper is around a single one.

    Args:
        task: a name of `envs.names()`.
        tradeoff: (m,) not negative; used as it is, so it need not sum to one.
        num_envs: N.
        device: as for `envs.make`.
        backend: likewise.
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
        **task_options: Any,
    ):
        self.vector = GymnasiumVectorEnv(task, num_envs, device, backend, tradeoff, **task_options)
        self._statistics = EpisodeStatistics(self.vector)
        self._tradeoff = np.asarray(tradeoff, dtype=np.float32)
        self._actions: NDArray | None = None
        super().__init__(
            num_envs, self.vector.single_observation_space, self.vector.single_action_space
        )

    def reset(self) -> NDArray[np.float32]:
        """Start every world anew: (N, O). The first of the seeds that `seed` made is used."""
        observation, _ = self._statistics.reset(seed=self._seeds[0], options=self._options[0])
        self._reset_seeds()
        self._reset_options()
        return observation.cpu().numpy()

    def step_async(self, actions: NDArray) -> None:
        """Take note of actions (N, A) in [-1, 1].

        Raises:
            MorlaxError: they are not finite.
        """
        if not np.isfinite(actions).all():
            raise MorlaxError("actions must be finite, but these hold a NaN or an infinity.")
        self._actions = actions

    def step_wait(self) -> tuple[NDArray, NDArray, NDArray, list[dict[str, Any]]]:
        """Make the step: observation (N, O), reward (N,), done (N,) and N infos.

        Raises:
            MorlaxError: actions of another shape, or no reset before.
        """
        actions = torch.as_tensor(self._actions, device=self.vector.device)
        observation, reward, terminated, truncated, info = self._statistics.step(actions)
        done = (terminated | truncated).cpu().numpy()
        timed_out = (truncated & ~terminated).cpu().numpy()
        objectives = info["vector_reward"].cpu().numpy()
        infos: list[dict[str, Any]] = [
            {"TimeLimit.truncated": over, "vector_reward": paid}
            for over, paid in zip(timed_out.tolist(), objectives, strict=True)
        ]
        if done.any():
            final = info["final_obs"].cpu().numpy()
            episode = {name: values.cpu().numpy() for name, values in info["episode"].items()}
            for world in done.nonzero()[0]:
                infos[world]["terminal_observation"] = final[world]
                infos[world]["episode"] = {
                    "r": float(episode["r"][world] @ self._tradeoff),
                    "l": int(episode["l"][world]),
                    "t": float(episode["t"][world]),
                    "returns": episode["r"][world],
                }
        return observation.cpu().numpy(), reward.cpu().numpy(), done, infos

    def close(self) -> None:
        """Nothing is left open."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The batch's attribute, once for each of the worlds asked for."""
        return [getattr(self.vector, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused.

        Raises:
            MorlaxError: always.
        """
        raise MorlaxError(
            f"{attr_name} cannot be set: the worlds are one batch, whose options are given when "
            "it is made."
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused.

        Raises:
            MorlaxError: always.
        """
        raise MorlaxError(
            f"{method_name} cannot be called for single worlds: they are one batch. Call it on "
            "`env.vector`."
        )

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        """False for each of the worlds asked for."""
        return [False for _ in self._get_indices(indices)]
