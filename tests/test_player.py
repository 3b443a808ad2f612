"""A single robot to look at does what the many of an evaluation do."""

import mujoco
import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError, Policy, envs
from morlax_torch.config import load_config, task_values
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.networks.agent import Agent
from morlax_torch.viewers.player import Player


@pytest.fixture
def policy() -> Policy:
    config = load_config(task_values("hopper", "cpu"))
    generator = torch.Generator().manual_seed(3)
    env = envs.make("hopper", 1, "cpu")
    agent = Agent(env.observation_size, env.action_size, 2, config.network, generator)
    return Policy(agent, config, env.objectives)


def test_an_episode_pays_what_an_evaluation_says(policy):
    tradeoffs = torch.tensor([[0.2, 0.8]])
    judges = envs.make("hopper", 1, "cpu", auto_reset=False)
    front = Evaluator(policy.agent, judges, tradeoffs).evaluate()
    player = Player(policy, (0.2, 0.8))
    while not player.over:
        player.step()
    assert player.steps == front.lengths[0]
    np.testing.assert_allclose(player.returns, front.returns[0], rtol=1e-4)


def test_no_episode_is_shortened_by_what_staggers_training(make_policy):
    policy = make_policy("cheetah", task={"stagger": True, "episode_length": 100})
    player = Player(policy, (0.5, 0.5))
    for _ in range(2):
        while not player.over:
            player.step()
        assert player.steps == 100
        player.reset()


def test_what_is_drawn_is_where_the_robot_is(policy):
    player = Player(policy, (1.0, 0.0))
    for _ in range(5):
        player.step()
    fresh = mujoco.MjData(player.model)
    fresh.qpos[:] = player.env.physics.qpos[0].numpy()
    mujoco.mj_kinematics(player.model, fresh)
    np.testing.assert_array_equal(player.data.geom_xpos, fresh.geom_xpos)


def test_a_reset_begins_anew(policy):
    player = Player(policy, (1.0, 0.0))
    first = [player.step().reward.clone() for _ in range(3)]
    player.reset()
    assert player.steps == 0 and not player.returns.any()
    again = [player.step().reward for _ in range(3)]
    assert torch.equal(torch.cat(first), torch.cat(again))


def test_a_tradeoff_that_is_none_leaves_the_old_one(policy):
    player = Player(policy, (1.0, 0.0))
    with pytest.raises(MorlaxError, match="not negative"):
        player.tradeoff = (-1.0, 2.0)
    assert player.tradeoff.tolist() == [1.0, 0.0]
