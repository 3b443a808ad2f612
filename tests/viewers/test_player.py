"""A player's single robot behaves like the robots of an evaluation."""

import mujoco
import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError, Policy, envs
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.viewers.player import Player


@pytest.fixture
def policy(make_policy) -> Policy:
    return make_policy("hopper")


def test_a_player_s_returns_match_an_evaluation(policy):
    tradeoffs = torch.tensor([[0.2, 0.8]])
    env = envs.make("hopper", 1, "cpu", auto_reset=False)
    front = Evaluator(policy.agent, env, tradeoffs).evaluate()
    player = Player(policy, (0.2, 0.8))
    while not player.over:
        player.step()
    assert player.steps == front.lengths[0]
    np.testing.assert_allclose(player.returns, front.returns[0], rtol=1e-4)


def test_the_drawn_robot_matches_the_simulated_pose_and_restarts(policy):
    player = Player(policy, (1.0, 0.0))
    first = [player.step().reward.clone() for _ in range(3)]
    fresh = mujoco.MjData(player.model)
    fresh.qpos[:] = player.env.physics.qpos[0].numpy()
    mujoco.mj_kinematics(player.model, fresh)
    np.testing.assert_array_equal(player.data.geom_xpos, fresh.geom_xpos)
    player.reset()
    assert player.steps == 0 and not player.returns.any()
    again = [player.step().reward for _ in range(3)]
    assert torch.equal(torch.cat(first), torch.cat(again))
    with pytest.raises(MorlaxError, match="not negative"):
        player.tradeoff = (-1.0, 2.0)
    assert player.tradeoff == (1.0, 0.0)
