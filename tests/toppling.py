"""Actions that end episodes, for tests of what happens then."""

import torch
from torch import Tensor


def falling(num_envs: int = 4, num_actions: int = 6) -> Tensor:
    """Held actions (N, A) that topple each walker after a time of its own; the first stands."""
    actions = torch.rand(num_envs, num_actions, generator=torch.Generator().manual_seed(0)) * 2 - 1
    actions[0] = 0.0
    return actions
