"""A player's single robot behaves like the robots of an evaluation."""

import mujoco
import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError, Policy, envs
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import task_values
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.networks.agent import Agent, Sizes
from morlax_torch.viewers.player import Player

CART = """
<mujoco>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1"/></body>
    <body name="flag" mocap="true" pos="0 0 1"/>
  </worldbody>
  <actuator><general joint="x" dyntype="filter" dynprm="0.5" gainprm="10"/></actuator>
</mujoco>
"""


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


def test_staggering_does_not_shorten_a_player_s_episodes(make_policy):
    policy = make_policy("cheetah", task={"stagger": True, "episode_length": 100})
    player = Player(policy, (0.5, 0.5))
    for _ in range(2):
        while not player.over:
            player.step()
        assert player.steps == 100
        player.reset()


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
    assert player.tradeoff.tolist() == [1.0, 0.0]


class Cart(envs.Environment):
    """A cart whose motor lags behind its control."""

    substeps = 10

    class Options(envs.TaskOptions):
        objectives: dict[str, dict[str, float]] = {"far": {"far": 1.0}, "near": {"near": 1.0}}
        episode_length: int = 100

    @classmethod
    def load_model(cls) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(CART)

    def initial_qpos(self) -> np.ndarray:
        return self.physics.model.qpos0

    def observe(self) -> torch.Tensor:
        return torch.cat([self.physics.qpos, self.physics.qvel], -1)

    def apply(self, action: torch.Tensor) -> None:
        self.physics.ctrl.fill_(1.0)

    def failed(self) -> torch.Tensor:
        return self.physics.qpos[:, 0] < -100

    def terms(self) -> dict[str, torch.Tensor]:
        x = self.physics.qpos[:, 0]
        return {"far": x, "near": -x}


def test_motor_forces_include_activations(monkeypatch):
    monkeypatch.setattr(envs.registry, "_REGISTRY", {"cart-with-lag": Cart})
    config = load_config(task_values("cart-with-lag", "cpu"))
    player = Player(Policy(Agent(config, Sizes(2, 1, 2)), config, ("far", "near")), (0.5, 0.5))
    player.env.physics.part("mocap_pos")[0, 0, 2] = 3.0
    for _ in range(50):
        player.step()
    assert player.data.body("flag").xpos[2] == 3.0
    activation = player.env.physics.act[0].item()
    assert 0.3 < activation < 1
    np.testing.assert_allclose(player.data.actuator_force, [10 * activation], rtol=1e-6)
