"""Policies in the form that morl-baselines evaluates; does not import morl-baselines."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..networks.policy import Policy


class MorlBaselinesAgent:
    """An agent for `policy_evaluation_mo` and `eval_mo` of morl-baselines.

    Evaluate it in a single environment, such as `gymnasium.make("morlax_torch/Hopper-v0")`.

    Args:
        policy: from `morlax_torch.load`, on any device.
        gamma: discount factor per control step, for the discounted returns.
    """

    def __init__(self, policy: Policy, gamma: float = 0.99):
        self.policy, self.gamma = policy, gamma

    def eval(self, obs: ArrayLike, w: ArrayLike) -> NDArray[np.float32]:
        """Return the action (A,) in (-1, 1) for an observation (O,) under a trade-off w (m,).

        Raises:
            MorlaxError: `obs` does not fit the policy's task, or `w` is not a trade-off.
        """
        return self.policy(np.asarray(obs, np.float32), np.asarray(w, np.float32)).cpu().numpy()
