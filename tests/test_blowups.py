"""A world that blows up is terminated, counted and reset, and harms no other world."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from morlax_torch import MORLAX, config_for, envs

SLIDER = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body><joint name="x" type="slide" axis="1 0 0" damping="1"/><geom size="0.1"/></body>
  </worldbody>
  <actuator><general joint="x" dyntype="filter" dynprm="0.5" gainprm="10"/></actuator>
</mujoco>
"""


@pytest.fixture
def slider(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[envs.Environment]:
    """A robot whose actuator has an activation: force follows control with a lag of 0.5 s."""
    path = tmp_path / "slider.xml"
    path.write_text(SLIDER)

    class Slider(envs.Environment):
        model_file = str(path)

        class Options(envs.TaskOptions):
            objectives: dict[str, dict[str, float]] = {"go": {"go": 1.0}, "save": {"save": 1.0}}
            episode_length: int = 10
            nconmax: int = 4
            njmax: int = 8

        def initial_qpos(self) -> np.ndarray:
            return np.zeros(1)

        def observe(self) -> Tensor:
            return torch.cat([self.physics.qpos, self.physics.qvel], -1)

        def apply(self, action: Tensor) -> None:
            self.physics.ctrl.copy_(action)

        def terms(self) -> dict[str, Tensor]:
            return {"go": self.physics.qvel[:, 0], "save": -self.physics.ctrl.square().sum(-1)}

        def failed(self) -> Tensor:
            return self.physics.qpos[:, 0] > 100.0

    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
    envs.register("slider", Slider)
    return Slider


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_an_episode_starts_without_activation(slider, backend):
    env = envs.make("slider", 2, "cpu", backend)
    full = torch.ones(2, 1)
    first = [env.step(full).reward[:, 0].clone() for _ in range(10)]  # the tenth step truncates
    second = [env.step(full).reward[:, 0].clone() for _ in range(10)]
    assert first[-1].min() > 0
    torch.testing.assert_close(torch.stack(second), torch.stack(first))


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_a_saved_state_holds_the_activation(slider, backend):
    env, other = (envs.make("slider", 2, "cpu", backend) for _ in range(2))
    for _ in range(5):
        env.step(torch.ones(2, 1))
    other.load_state_dict(env.state_dict())
    for _ in range(3):
        step, same = (worlds.step(torch.zeros(2, 1)) for worlds in (env, other))
        assert torch.equal(step.observation, same.observation)


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_a_nan_action_ends_one_episode_and_no_more(slider, backend):
    env, clean = (envs.make("slider", 2, "cpu", backend) for _ in range(2))
    for t in range(8):
        action = torch.full((2, 1), 0.5)
        expected = clean.step(action)
        if t == 2:
            action[0] = float("nan")
        step = env.step(action)
        assert step.reward.isfinite().all() and step.observation.isfinite().all()
        assert step.terminated.tolist() == [t == 2, False]
        torch.testing.assert_close(step.reward[1], expected.reward[1], rtol=0, atol=0)
    assert env.blowups == 1


@pytest.mark.parametrize("velocity", [1e5, 1e7, 1e9, 1e12])
@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_a_huge_but_finite_velocity_is_a_blowup(backend, velocity):
    env = envs.make("ant", 3, "cpu", backend)
    env.physics.qvel[1] = velocity
    step = env.step(torch.zeros(3, env.action_size))
    assert step.terminated.tolist() == [False, True, False]
    assert env.blowups == 1
    for values in (step.reward[1], step.final_observation[1]):
        assert (values == 0).all()
    assert all(term[1] == 0 for term in step.terms.values())
    assert step.observation.abs().max() < 100


def test_terms_of_a_blown_up_world_are_zero():
    env = envs.make("cheetah", 2, "cpu")
    env.physics.qpos[0] = float("nan")
    step = env.step(torch.zeros(2, env.action_size))
    assert all(term.isfinite().all() for term in step.terms.values())
    assert step.terms["alive"].tolist() == [0, 1]


def test_training_survives_a_world_with_a_huge_velocity():
    config = config_for(
        "ant",
        worlds=512,
        horizon=4,
        device="cpu",
        **{"ppo.epochs": 1, "ppo.minibatches": 2, "sampling.clusters": 8},
    )
    env = envs.make("ant", 512, "cpu", **config.task.model_dump())
    morlax = MORLAX(env, config)
    morlax.iterate()
    env.physics.qvel[7] = 1e9
    morlax.iterate()
    scale = morlax.agent.value_normalizer.variance.clone()
    morlax.iterate()
    metrics = morlax.metrics()
    assert metrics["blowups"] == 1
    assert all(np.isfinite(value) for value in metrics.values())
    assert all(value.isfinite().all() for value in morlax.agent.state_dict().values())
    assert scale.max() < 1e6
