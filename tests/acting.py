"""Actions for all worlds of a task, and an episode of one."""

from collections.abc import Callable

import torch
from torch import Tensor

from morlax_torch import envs


def still(env: envs.Worlds) -> Tensor:
    return torch.zeros(env.num_worlds, env.action_size)


def random_actions(env: envs.Worlds, steps: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(steps, env.num_worlds, env.action_size, generator=generator) * 2 - 1


def falling(num_envs: int = 4, num_actions: int = 6) -> Tensor:
    """Return constant actions (N, A); walkers fall at different times, the first never."""
    actions = torch.rand(num_envs, num_actions, generator=torch.Generator().manual_seed(0)) * 2 - 1
    actions[0] = 0.0
    return actions


@torch.no_grad()
def episode(env: envs.Worlds, act: Callable[[Tensor], Tensor]) -> tuple[list[float], int]:
    """Return the returns (m,) of a single world, and the number of steps."""
    observation, returns, steps = env.reset(), torch.zeros(1, len(env.objectives)), 0
    while True:
        step = env.step(act(observation))
        returns, steps = returns + step.reward, steps + 1
        if step.terminated or step.truncated:
            return returns[0].tolist(), steps
        observation = step.observation
