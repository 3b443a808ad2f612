"""Returns and lengths of the episodes that training completes."""

import torch

from .rollout import Rollout


class Episodes:
    """Sums the rewards and steps of N worlds until their episodes end.

    Episodes are longer than rollouts, so `running` carries every world's sums to the next rollout.

    Args:
        num_worlds: N.
        num_objectives: m.
        device: that holds the rollouts.
    """

    def __init__(self, num_worlds: int, num_objectives: int, device: torch.device):
        self.running = torch.zeros(num_worlds, num_objectives + 1, device=device)
        self.totals = torch.zeros(num_objectives + 2, device=device)
        """Summed over completed episodes: returns (m), steps, and their number."""

    def observe(self, rollout: Rollout) -> None:
        """Add a rollout, in place. Runs inside a recorded graph."""
        over = (rollout.terminated | rollout.truncated).flatten(1)  # (T, N)
        ahead = over.int().flip(0).cumsum(0).flip(0) > 0  # an episode ends at this step or later
        reward = rollout.reward.flatten(1, 2)
        steps = torch.cat([reward, torch.ones_like(reward[..., :1])], -1)  # (T, N, m + 1)
        completed = torch.where(ahead[..., None], steps, 0.0).sum(0)
        any_over = ahead[:1].mT  # (N, 1)
        completed += torch.where(any_over, self.running, 0.0)
        self.totals += torch.cat([completed.sum(0), over.sum()[None]])
        begun = torch.where(ahead[..., None], 0.0, steps).sum(0)
        self.running.copy_(torch.where(any_over, begun, self.running + begun))
