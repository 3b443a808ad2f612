"""A check that worlds of other libraries share."""

from pathlib import Path

import torch

from morlax_torch import load
from morlax_torch.commands.train import command
from morlax_torch.configuration.config import Config
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import read_rows
from morlax_torch.train import train


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
