"""Episode statistics of a vector environment: returns per objective, lengths and times."""

import time
from typing import Any

import torch
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray
from torch import Tensor

from ..envs import MorlaxError
from .gymnasium import GymnasiumVectorEnv


class EpisodeStatistics(VectorWrapper):
    """Adds the statistics of finished episodes to `info`, on the device and without a GPU sync.

    `info["episode"]` holds "r" (N, m), the return per objective; "dr" (N, m), the discounted
    return; "l" (N,), the length in control steps; and "t" (N,), the wall-clock time in seconds.
    The mask `info["_episode"]` (N,) marks the worlds whose episode ended in this step; all other
    entries are zero. Returns are not weighted, even if the environment has a `tradeoff`. For
    numpy, put `ArrayConversion` around this wrapper.

    The keys are those of `MORecordEpisodeStatistics` (MO-Gymnasium 1.3.2), which would lose first
    steps here: it assumes that a world spends a step on its reset.

    Args:
        env: the unwrapped environment from `gymnasium.make_vec`.
        gamma: discount factor per control step, for "dr".

    Raises:
        MorlaxError: `env` is already wrapped, or is not a `GymnasiumVectorEnv`.
    """

    env: GymnasiumVectorEnv

    def __init__(self, env: GymnasiumVectorEnv, gamma: float = 1.0):
        if not isinstance(env, GymnasiumVectorEnv):
            raise MorlaxError(
                "EpisodeStatistics must directly wrap gymnasium.make_vec('morlax_torch/...'), "
                f"not {type(env).__name__}: apply other wrappers after it."
            )
        super().__init__(env)
        self._gamma = gamma
        N, device = env.num_envs, env.device
        self._sums = torch.zeros(2, N, len(env.objectives), dtype=torch.float32, device=device)
        self._lengths = torch.zeros(N, dtype=torch.int64, device=device)
        self._starts = torch.zeros(N, dtype=torch.float64, device=device)

    def reset(self, **seed_and_options: Any) -> tuple[Tensor, dict[str, Any]]:
        """Reset all worlds and statistics; returns the observation (N, O) and an empty info."""
        self._begin(torch.ones_like(self._lengths, dtype=torch.bool))
        return self.env.reset(**seed_and_options)

    def step(
        self, actions: Tensor | NDArray
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance by one control step under actions (N, A), and add the statistics to `info`."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        objectives = info.get("vector_reward", reward)
        discounted = self._gamma ** self._lengths[:, None].float() * objectives
        self._sums += torch.stack([objectives, discounted])
        self._lengths += 1
        info["_episode"] = done = terminated | truncated
        returns, discounted = torch.where(done[:, None], self._sums, 0.0)
        info["episode"] = {
            "r": returns,
            "dr": discounted,
            "l": torch.where(done, self._lengths, 0),
            "t": torch.where(done, time.perf_counter() - self._starts, 0.0),
        }
        self._begin(done)
        return observation, reward, terminated, truncated, info

    def _begin(self, worlds: Tensor) -> None:
        self._sums.masked_fill_(worlds[:, None], 0.0)
        self._lengths.masked_fill_(worlds, 0)
        self._starts.masked_fill_(worlds, time.perf_counter())
