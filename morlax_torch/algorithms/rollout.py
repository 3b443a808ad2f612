"""Collect rollouts, count their episodes and estimate advantages."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..configuration.sections import PPOConfig
from ..envs import Worlds

Explore = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Maps raw observations (K, G, O) and standard normal noise (K, G, A) to actions before the tanh
(K, G, A) and their log-probabilities (K, G)."""


class Rollout(NamedTuple):
    """T steps of K clusters of G worlds. Each iteration overwrites the last."""

    observation: Tensor  # (T, K, G, O + P) raw, as critics see it
    action: Tensor  # (T, K, G, A) before the tanh
    log_prob: Tensor  # (T, K, G)
    reward: Tensor  # (T, K, G, m)
    terminated: Tensor  # (T, K, G) bool
    truncated: Tensor  # (T, K, G) bool
    final_observation: Tensor  # (T, K, G, O + P) after the step, before any reset

    @classmethod
    def empty(cls, horizon: int, clusters: int, env: Worlds) -> "Rollout":
        """Allocate the rollout of `env` with T = `horizon` and K = `clusters`."""

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            sizes = horizon, clusters, env.num_worlds // clusters, *shape
            return torch.zeros(sizes, dtype=dtype, device=env.device)

        return cls(
            observation=zeros(env.observation_size + env.privileged_size),
            action=zeros(env.action_size),
            log_prob=zeros(),
            reward=zeros(len(env.objectives)),
            terminated=zeros(dtype=torch.bool),
            truncated=zeros(dtype=torch.bool),
            final_observation=zeros(env.observation_size + env.privileged_size),
        )

    def first(self, steps: int) -> "Rollout":
        """Return views of the first `steps`."""
        return Rollout(*(values[:steps] for values in self))


@torch.no_grad()
def collect(
    env: Worlds, explore: Explore, observation: Tensor, rollout: Rollout, generator: torch.Generator
) -> None:
    """Fill `rollout`: each of K actors explores its own cluster, G worlds in a row.

    They see the first O features of `observation` (N, O + P), which is updated in place to the
    end of the rollout. The generator draws their noise.
    """
    rollout.observation[0].copy_(observation.view_as(rollout.observation[0]))
    noise = torch.empty_like(rollout.action).normal_(generator=generator)
    last = len(noise) - 1
    for t in range(len(noise)):
        seen = rollout.observation[t, ..., : env.observation_size]
        action, log_prob = explore(seen, noise[t])
        step = env.step(action.tanh().flatten(0, 1))
        following = observation if t == last else rollout.observation[t + 1]
        pairs = (
            (following, step.critic_observation),
            (rollout.action[t], action),
            (rollout.log_prob[t], log_prob),
            (rollout.reward[t], step.reward),
            (rollout.terminated[t], step.terminated),
            (rollout.truncated[t], step.truncated),
            (rollout.final_observation[t], step.final_critic_observation),
        )
        for target, source in pairs:
            target.copy_(source.view_as(target))


def advantages(rollout: Rollout, value: Tensor, final_value: Tensor, ppo: PPOConfig) -> Tensor:
    """Estimate generalized advantages, one objective at a time: (T, K, G, m).

    A_t = delta_t + discount * gae_lambda * (1 - done_t) * A_{t+1}, where
    delta_t = r_t + discount * (1 - terminated_t) * V(s'_t) - V(s_t)
    and s' is the next state before any reset. (Schulman et al., 2016, eq. 16.) After a failure
    there is no value. After a time limit there is: the critic's value of the last state before the
    reset. With `truncation: mask`, a truncated step contributes nothing, as in the paper's
    released code. `value` is V(s_t) and `final_value` V(s'_t), (T, K, G, m) each.
    """
    terminated, truncated = rollout.terminated.unsqueeze(-1), rollout.truncated.unsqueeze(-1)
    surprise = rollout.reward + ppo.discount * torch.where(terminated, 0.0, final_value) - value
    if ppo.truncation == "mask":
        surprise = torch.where(truncated, 0.0, surprise)
    carry = torch.where(terminated | truncated, 0.0, ppo.discount * ppo.gae_lambda).to(surprise)
    advantage = torch.empty_like(surprise)
    running = torch.zeros_like(surprise[0])
    for t in reversed(range(len(surprise))):
        running = torch.addcmul(surprise[t], carry[t], running)
        advantage[t] = running
    return advantage


class Episodes:
    """Sums the rewards and steps of N worlds until their episodes end.

    Episodes are longer than rollouts, so `running` carries every world's sums to the next rollout.
    """

    def __init__(self, num_worlds: int, num_objectives: int, device: torch.device):
        self.totals = torch.zeros(num_objectives + 2, dtype=torch.float32, device=device)
        """Summed over completed episodes: returns (m), steps, and their number."""
        self.running = self.totals.new_zeros(num_worlds, num_objectives + 1)

    def observe(self, rollout: Rollout) -> None:
        """Add a rollout, in place. Runs inside a recorded graph."""
        # without loops or boolean indexing, which a recorded graph cannot hold: a world's steps up
        # to its last ending belong to completed episodes, those after it to the one under way
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
