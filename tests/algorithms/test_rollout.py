"""Advantages follow their formula, and rollouts store what the worlds returned."""

import numpy as np
import pytest
import torch

from morlax_torch import envs
from morlax_torch.algorithms.rollout import Rollout, advantages, collect
from morlax_torch.configuration.sections import PPOConfig

GAMMA, LAMBDA = 0.9, 0.8


def looped(
    rollout: Rollout, value: torch.Tensor, final_value: torch.Tensor, bootstrap: bool
) -> np.ndarray:
    """Compute advantages by definition, one world and one objective at a time."""
    horizon, clusters, worlds, objectives = value.shape
    result = np.zeros(value.shape)
    for k, g, i in np.ndindex(clusters, worlds, objectives):
        following = 0.0
        for t in reversed(range(horizon)):
            terminated, truncated = rollout.terminated[t, k, g], rollout.truncated[t, k, g]
            future = 0.0 if terminated else final_value[t, k, g, i].item()
            delta = rollout.reward[t, k, g, i].item() + GAMMA * future - value[t, k, g, i].item()
            if truncated and not bootstrap:
                delta = 0.0
            if terminated or truncated:
                following = 0.0
            following = delta + GAMMA * LAMBDA * following
            result[t, k, g, i] = following
    return result


@pytest.mark.parametrize("truncation", ("bootstrap", "mask"))
@pytest.mark.parametrize("objectives", (2, 3))
def test_advantages_match_their_definition(make_rollout, truncation, objectives):
    config = PPOConfig(discount=GAMMA, gae_lambda=LAMBDA, truncation=truncation)
    rollout = make_rollout(num_objectives=objectives)
    value, final_value = torch.randn(2, *rollout.reward.shape)
    advantage = advantages(rollout, value, final_value, config)
    expected = looped(rollout, value, final_value, truncation == "bootstrap")
    np.testing.assert_allclose(advantage, expected, rtol=1e-5, atol=1e-5)
    final_value[rollout.terminated] = torch.nan  # is ignored
    assert torch.equal(advantages(rollout, value, final_value, config), advantage)


CLUSTERS, WORLDS, HORIZON = 4, 8, 24
TRADEOFFS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7], [0.5, 0.5]])


def hopper() -> envs.Environment:
    return envs.make("hopper", WORLDS, "cpu", "mujoco", episode_length=10, reset_noise=0.01)


@pytest.fixture
def collected(make_agent, generator):
    """Collect a rollout; return it with the agent and the first and last observations."""
    env = hopper()
    agent = make_agent(env.observation_size, env.action_size)
    agent.observation_normalizer.update(torch.randn(50, env.observation_size, generator=generator))
    first = env.reset()
    observation = first.clone()
    rollout = Rollout.empty(HORIZON, CLUSTERS, env)
    collect(env, agent.actors(TRADEOFFS).explore, observation, rollout, generator)
    return rollout, agent, first, observation


def test_stored_log_probs_come_from_each_cluster_s_own_policy(collected):
    rollout, agent, _, _ = collected
    for k in range(CLUSTERS):
        policies = agent.policies(TRADEOFFS[k : k + 1])
        seen = agent.observation_normalizer(rollout.observation[:, k]).flatten(0, 1)[None]
        expected = policies(seen).log_prob(rollout.action[:, k].flatten(0, 1)[None])
        found = rollout.log_prob[:, k].flatten()
        torch.testing.assert_close(found, expected[0], rtol=1e-5, atol=1e-4)


def test_replaying_the_stored_actions_gives_the_stored_rollout(collected):
    rollout, _, first, last = collected
    env = hopper()
    observation = env.reset()
    torch.testing.assert_close(observation, first)
    for t in range(HORIZON):
        torch.testing.assert_close(rollout.observation[t].flatten(0, 1), observation)
        step = env.step(rollout.action[t].tanh().flatten(0, 1))
        torch.testing.assert_close(rollout.reward[t].flatten(0, 1), step.reward)
        torch.testing.assert_close(
            rollout.final_observation[t].flatten(0, 1), step.final_observation
        )
        assert torch.equal(rollout.terminated[t].flatten(), step.terminated)
        assert torch.equal(rollout.truncated[t].flatten(), step.truncated)
        observation = step.observation
    torch.testing.assert_close(last, observation)
    assert rollout.truncated.any()
