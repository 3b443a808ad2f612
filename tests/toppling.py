"""Actions that make robots fall, for tests of episode ends."""

import torch
from torch import Tensor


def falling(num_envs: int = 4, num_actions: int = 6) -> Tensor:
    """Return constant actions (N, A); walkers fall at different times, the first never."""
    actions = torch.rand(num_envs, num_actions, generator=torch.Generator().manual_seed(0)) * 2 - 1
    actions[0] = 0.0
    return actions
