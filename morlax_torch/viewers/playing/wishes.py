"""Random commands and trade-offs, as a user might wish for them."""

import numpy as np

from .deployment import Export
from .policy import Policy
from .robot import Array

PERIODS = 3.0, 8.0  # s for which a command or a trade-off is wished for
STANDING = 0.1  # share of the commands that are to stand still


class Wishes:
    """Draws commands within the ranges and trade-offs on the simplex, each for some seconds."""

    def __init__(self, deployment: Export, rng: np.random.Generator):
        self._low, self._high = np.array(deployment.settings.limits).T
        self._rng = rng
        self._until = [0.0, 0.0]  # s: of the command and the trade-off
        self._command = np.zeros(3)

    def command(self, seconds: float, policy: Policy) -> Array:
        """Return the command (3,) at this time, and tell the policy its trade-off."""
        if seconds >= self._until[0]:
            self._until[0] = seconds + self._rng.uniform(*PERIODS)
            walks = self._rng.random() >= STANDING
            self._command = walks * self._rng.uniform(self._low, self._high)
        if seconds >= self._until[1]:
            self._until[1] = seconds + self._rng.uniform(*PERIODS)
            target = self._rng.dirichlet(np.ones(len(policy.objectives)))
            policy.choose(target, at_once=seconds == 0)
        return self._command
