"""The examples in docs/ run and learn."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from morlax_torch import envs
from morlax_torch.gpu.resources import one_thread

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
TWO_GOALS = f"{EXAMPLES / 'two_goals.py'}:TwoGoals"


def imported(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_cleanrl_style_ppo_example_learns(capsys):
    example = imported("cleanrl_ppo")
    settings = example.Settings(
        env_id="morlax_torch/Hopper-v0",
        device="cpu",
        total_timesteps=40_000,
        num_envs=64,
        episode_length=100,
    )
    with one_thread(torch.device("cpu")):
        returns = example.train(settings)
    assert np.mean(returns[-3:]) > 2 * returns[0]
    assert "steps/s" in capsys.readouterr().out


def test_the_arm_between_two_goals_earns_what_its_kinematics_say():
    two_goals = imported("two_goals")
    env = envs.make(TWO_GOALS, 21, "cpu", auto_reset=False)
    left, right = env.goal("left"), env.goal("right")
    tips = right + np.linspace(0, 1, 21)[:, None] * (left - right)  # m
    expected = two_goals.nearness(torch.from_numpy(tips), env.goals.cpu()).numpy()
    action = torch.from_numpy(two_goals.joint_angles(tips) - env.initial_qpos()).float()
    for _ in range(env.episode_length):
        step = env.step(action)
    assert np.abs(step.reward.numpy() - expected).max() < 1e-3
    assert expected.sum(1).min() < 0.5 * expected.sum(1).max()  # worse than a mix of the ends
