"""Our policies where morl-baselines evaluates its own; of it, nothing is needed here."""

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from ..envs import MorlaxError
from ..networks.policy import Policy


class MorlBaselinesAgent:
    """What `policy_evaluation_mo` and `eval_mo` of morl-baselines take for an agent.

    Its environments are our single ones, `gymnasium.make("morlax_torch/Hopper-v0")`.

    Args:
        policy: as `morlax_torch.load` gives it, on any device.
        gamma: the discount of what is called a discounted return, for a control step.
    """

    def __init__(self, policy: Policy, gamma: float = 0.99):
        self.policy, self.gamma = policy, gamma

    def eval(self, obs: ArrayLike, w: ArrayLike) -> NDArray[np.float32]:
        """The action (A,) in (-1, 1) for an observation (O,) under a trade-off w (m,).

        Raises:
            MorlaxError: it is no observation of the policy's task, or no trade-off.
        """
        agent = self.policy.agent
        place = agent.observation_normalizer.mean.device
        seen = torch.as_tensor(np.asarray(obs, dtype=np.float32), device=place)
        if seen.shape != (agent.observation_size,):
            raise MorlaxError(
                f"an observation of this policy is {agent.observation_size} numbers, but this "
                f"has the shape {tuple(seen.shape)}: is it from another task?"
            )
        return self.policy(seen[None], np.asarray(w, dtype=np.float32))[0].cpu().numpy()
