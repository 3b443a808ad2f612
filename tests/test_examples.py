"""The examples in docs/ run and learn."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch

from morlax_torch.gpu.threads import one_thread

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"


@pytest.fixture
def cleanrl_ppo():
    spec = importlib.util.spec_from_file_location("cleanrl_ppo", EXAMPLES / "cleanrl_ppo.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_cleanrl_style_ppo_example_learns(cleanrl_ppo, capsys):
    settings = cleanrl_ppo.Settings(
        env_id="morlax_torch/Hopper-v0",
        device="cpu",
        total_timesteps=60_000,
        num_envs=64,
        episode_length=100,
    )
    with one_thread(torch.device("cpu")):
        returns = cleanrl_ppo.train(settings)
    assert np.mean(returns[-3:]) > 2 * returns[0]
    assert "steps/s" in capsys.readouterr().out
