"""Returns of whole episodes, objective by objective, in a vector environment."""

import time
from typing import Any

import torch
from gymnasium.vector import VectorWrapper
from torch import Tensor

from ..envs import MorlaxError
from .gymnasium_vector import GymnasiumVectorEnv


class EpisodeStatistics(VectorWrapper):
    """Adds what each episode that ended paid to `info`, on the device, without waiting for it.

    `info["episode"]` holds "r" (N, m) the return of each objective, "dr" (N, m) the discounted
    one, "l" (N,) control steps and "t" (N,) seconds of the clock; they are zero but where the mask
    `info["_episode"]` (N,) says that an episode ended in this step. A `tradeoff` changes nothing
    here. For numpy, put `ArrayConversion` around this wrapper.

    The keys are those of `MORecordEpisodeStatistics`, which takes a world to spend a step on its
    reset. Ours do not: there (MO-Gymnasium 1.3.2) each episode of a world but its first loses
    its first step, and discounted returns go on from one episode to the next.

    Args:
        env: as `gymnasium.make_vec` gives it.
        gamma: the discount of "dr", for a control step.

    Raises:
        MorlaxError: something is around the environment already, or it is none of ours.
    """

    def __init__(self, env: GymnasiumVectorEnv, gamma: float = 1.0):
        if not isinstance(env, GymnasiumVectorEnv):
            raise MorlaxError(
                "EpisodeStatistics goes directly around gymnasium.make_vec('morlax_torch/...'), "
                f"not around {type(env).__name__}: put other wrappers around it."
            )
        super().__init__(env)
        self._gamma = gamma
        self._returns = torch.zeros(env.num_envs, len(env.objectives), device=env.device)
        self._discounted = torch.zeros_like(self._returns)
        self._lengths = torch.zeros(env.num_envs, dtype=torch.int64, device=env.device)
        self._starts = torch.zeros(env.num_envs, dtype=torch.float64, device=env.device)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start every world, and every sum, anew."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin(torch.ones_like(self._lengths, dtype=torch.bool))
        return observation, info

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """One control step under actions (N, A)."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        objectives = info.get("vector_reward", reward)
        self._returns += objectives
        self._discounted += self._gamma ** self._lengths[:, None] * objectives
        self._lengths += 1
        done = terminated | truncated
        info["episode"] = {
            "r": torch.where(done[:, None], self._returns, 0.0),
            "dr": torch.where(done[:, None], self._discounted, 0.0),
            "l": torch.where(done, self._lengths, 0),
            "t": torch.where(done, time.perf_counter() - self._starts, 0.0),
        }
        info["_episode"] = done
        self._begin(done)
        return observation, reward, terminated, truncated, info

    def _begin(self, worlds: Tensor) -> None:
        self._returns.masked_fill_(worlds[:, None], 0.0)
        self._discounted.masked_fill_(worlds[:, None], 0.0)
        self._lengths.masked_fill_(worlds, 0)
        self._starts.masked_fill_(worlds, time.perf_counter())
