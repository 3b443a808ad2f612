"""Acting in the worlds, and judging what was done."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from .agent import Agent
from .envs import Worlds


@contextmanager
def one_thread(device: torch.device) -> Iterator[None]:
    """On the CPU, let torch use a single thread: its others would keep physics from the cores."""
    if device.type != "cpu":
        yield
        return
    usual = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(usual)


class Rollout(NamedTuple):
    """T steps of K clusters of G worlds. Each iteration overwrites the last."""

    observation: Tensor  # (T, K, G, O + P) as the environment gave it to the critic
    action: Tensor  # (T, K, G, A) before the tanh
    log_prob: Tensor  # (T, K, G)
    reward: Tensor  # (T, K, G, m)
    terminated: Tensor  # (T, K, G) bool
    truncated: Tensor  # (T, K, G) bool
    final_observation: Tensor  # (T, K, G, O + P) after the step, before any reset

    @classmethod
    def empty(cls, horizon: int, clusters: int, env: Worlds) -> "Rollout":
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


@torch.no_grad()
def collect(
    env: Worlds,
    agent: Agent,
    tradeoffs: Tensor,
    observation: Tensor,
    rollout: Rollout,
    generator: torch.Generator,
) -> None:
    """Fill `rollout`: each cluster acts by the policy of its own trade-off (K, m).

    `observation` (N, O + P) holds what the worlds show critics now; at the end, what they show
    then. The policies see no more than its first O numbers.
    """
    policies = agent.policies(tradeoffs)
    for t in range(len(rollout.reward)):
        seen = agent.observation_normalizer(observation)
        policy = policies(seen.unflatten(0, (len(tradeoffs), -1)))
        action, log_prob = policy.act(generator)
        step = env.step(action.tanh().flatten(0, 1))
        kept = Rollout(
            observation,
            action,
            log_prob,
            step.reward,
            step.terminated,
            step.truncated,
            step.final_critic_observation,
        )
        slots = [column[t] for column in rollout]
        values = [value.view_as(slot) for slot, value in zip(slots, kept, strict=True)]
        torch._foreach_copy_(slots, values)  # one kernel for all of a kind
        observation.copy_(step.critic_observation)


def advantages(
    rollout: Rollout,
    value: Tensor,
    final_value: Tensor,
    discount: float,
    gae_lambda: float,
    bootstrap: bool = True,
) -> Tensor:
    """Generalised advantage estimation, one objective at a time: (T, K, G, m).

    A_t = delta_t + discount * gae_lambda * (1 - done_t) * A_{t+1}, where
    delta_t = r_t + discount * (1 - terminated_t) * V(s'_t) - V(s_t)
    and s' is the state that really came next. (Schulman et al., 2016, eq. 16.) A failure has no
    future. A time limit does: the critic's opinion of the last state before the reset; without
    `bootstrap`, a truncated step instead counts for nothing, as in the paper's released code.

    Args:
        value: V(s_t), (T, K, G, m).
        final_value: V(s'_t), (T, K, G, m), whose last states are those before any reset.
    """
    terminated, truncated = rollout.terminated.unsqueeze(-1), rollout.truncated.unsqueeze(-1)
    surprise = rollout.reward + discount * torch.where(terminated, 0.0, final_value) - value
    if not bootstrap:
        surprise = torch.where(truncated, 0.0, surprise)
    carry = torch.where(terminated | truncated, 0.0, discount * gae_lambda)
    advantage = torch.empty_like(surprise)
    running = torch.zeros_like(surprise[0])
    for t in reversed(range(len(surprise))):
        running = torch.addcmul(surprise[t], carry[t], running)
        advantage[t] = running
    return advantage
