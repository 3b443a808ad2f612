"""The examples in docs/ run and learn."""

import importlib.util
import itertools
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch

from morlax_torch import MORLAX, config_for, envs, pareto

pytestmark = pytest.mark.usefixtures("single_thread")
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
OF_PPO = (*("epochs", "minibatches", "learning_rate", "discount", "gae_lambda", "clip", "entropy"),)
TWO_GOALS = f"{EXAMPLES / 'two_goals.py'}:TwoGoals"


def imported(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("task", ["cheetah", "hopper"])
def test_morlax_in_one_file_trains_bit_for_bit_as_the_package(task):
    changes = {"sampling.cells": False, "worlds": 64, "horizon": 8}
    config = config_for(task, device="cpu", **changes)
    network = config.network
    example = imported("morlax")
    options = example.Options(
        task,
        "cpu",
        config.seed,
        worlds=config.worlds,
        clusters=config.sampling.clusters,
        horizon=config.horizon,
        width=network.actor[0],
        hidden=network.hidden[0],
        features=network.features,
        decay_fraction=config.decay_fraction,
        **{name: getattr(config.ppo, name) for name in OF_PPO},
    )
    ours = example.MORLAX(envs.make(task, 64, "cpu", seed=config.seed), options)
    package = MORLAX(config.make_worlds(64, config.seed), config)
    for done in (0.0, 0.4, 0.8):
        ours.iterate(done)
        package.iterate(done)
    agent = package.agent
    for mine, theirs in (
        (ours.actor, agent.actor),
        (ours.critic, agent.critic),
        (ours.observations, agent.observation_normalizer),
        (ours.values, agent.value_normalizer),
    ):
        values = dict(theirs.named_parameters()) | dict(theirs.named_buffers())
        for name, value in (*mine.named_parameters(), *mine.named_buffers()):
            assert torch.equal(value, values[name]), name


def test_morlax_in_one_file_measures_hypervolumes_as_the_package():
    returns, reference = torch.randn(50, 2, dtype=torch.float64), (-0.5, 0.2)
    expected = pareto.hypervolume(returns.numpy(), reference)
    assert imported("morlax").hypervolume(returns, reference) == pytest.approx(expected)


@pytest.mark.slow
def test_morlax_in_one_file_learns_and_draws_its_front(tmp_path, capsys, monkeypatch):
    example = imported("morlax")
    options = example.Options(device="cpu", max_seconds=20.0, tradeoffs=32, worlds=64)
    clock = SimpleNamespace(perf_counter=itertools.count().__next__)  # a second per iteration
    monkeypatch.setattr(example, "time", clock)
    morlax, returns = example.train(options)
    example.plot(returns, morlax.env.objectives, str(tmp_path / "front.png"))
    volumes = [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()]
    assert volumes[-1] > 1.5 * volumes[0]
    assert (tmp_path / "front.png").stat().st_size > 5000


@pytest.mark.slow
def test_the_cleanrl_style_ppo_example_learns(capsys):
    example = imported("cleanrl_ppo")
    sizes = {"total_timesteps": 40_000, "num_envs": 64, "episode_length": 100}
    settings = example.Settings(env_id="morlax_torch/Hopper-v0", device="cpu", **sizes)
    returns = example.train(settings)
    assert np.mean(returns[-3:]) > 2 * returns[0]
    assert "steps/s" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:.*inherits from WeightUpdaterBase")  # when TorchRL is imported
@pytest.mark.slow
@pytest.mark.parametrize("library", ["torchrl", pytest.param("skrl", marks=pytest.mark.long)])
def test_another_library_trains_a_family_of_policies(library):
    pytest.importorskip(library, reason=f"{library} is not installed")
    example = imported(f"{library}_family")
    before, after = example.train(example.Options("hopper", "cpu", iterations=16))
    run, jump, balance = after  # the returns (2,) of one policy each
    assert run[0] > 1.3 * jump[0] and jump[1] > 1.1 * run[1]
    assert run[0] > 2 * before[0, 0] and jump[1] > 1.3 * before[1, 1]
    assert balance.sum() > 1.5 * before[2].sum()


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
