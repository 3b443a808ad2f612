"""Checks that worlds of other libraries share."""

from pathlib import Path

import torch

from morlax_torch import envs, load
from morlax_torch.commands.train import command
from morlax_torch.configuration.config import Config
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import read_rows
from morlax_torch.train import train


def noise(env: envs.Worlds) -> torch.Tensor:
    return 2 * torch.rand(env.num_worlds, env.action_size) - 1


def check_blown_up(env: envs.Worlds) -> None:
    """A world that is not finite terminates and earns nothing."""
    for _ in range(2):
        action = noise(env)
        action[1] = torch.nan
        step = env.step(action)
        assert step.blown_up.tolist() == step.terminated.tolist()
        assert step.blown_up.nonzero().tolist() == [[1]]
        assert not step.reward[1].any() and step.reward[0].any()
        assert step.observation.isfinite().all() and step.final_observation.isfinite().all()
    assert env.blowups == 2


def check_run(config: Config, folder: Path, capsys) -> None:
    """A run is trained, evaluated, loaded and resumed, in worlds that start anew."""
    run = train(config, output=folder).folder
    assert evaluate(run, tradeoffs=4, device="cpu").returns.shape == (4, 2)
    policy = load(run, device="cpu")
    observation = torch.zeros(1, policy.agent.observation_size)
    assert policy(observation, (0.5, 0.5)).shape == (1, policy.agent.action_size)
    before = read_rows(run / "metrics.csv")
    steps = config.max_env_steps + config.worlds * config.horizon
    command(["--resume", str(run), "--max-env-steps", str(steps)])
    assert "they start anew" in capsys.readouterr().out
    after = read_rows(run / "metrics.csv")
    assert after[: len(before)] == before and int(after[-1]["env_steps"]) == steps
