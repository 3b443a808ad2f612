"""Actions for all worlds of a task."""

import torch
from torch import Tensor

from morlax_torch import envs


def still(env: envs.Worlds) -> Tensor:
    return torch.zeros(env.num_worlds, env.action_size)


def random_actions(env: envs.Worlds, steps: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(steps, env.num_worlds, env.action_size, generator=generator) * 2 - 1
