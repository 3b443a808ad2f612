"""A packed run is small, acts as the run did, and cannot be mistaken for one to train on."""

from pathlib import Path

import numpy as np
import pytest
import torch

import morlax_torch
from morlax_torch import MorlaxError
from morlax_torch.config import load_config, merged, task_values
from morlax_torch.evaluation.front import Front
from morlax_torch.pack import pack
from morlax_torch.runs.run import Run
from morlax_torch.train import train


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    small = {
        "device": "cpu",
        "backend": "mujoco",
        "worlds": 32,
        "max_env_steps": 2000,
        "evaluation": {"tradeoffs": 8, "every": 1000},
    }
    config = load_config(merged(task_values("hopper", "cpu"), small))
    return train(config, output=tmp_path_factory.mktemp("runs") / "hopper").folder


@pytest.fixture(scope="module")
def packed(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("packed") / "hopper"
    pack(run, folder, "cpu")
    return folder


def test_it_acts_as_the_run_and_knows_its_front(run, packed):
    observation = torch.randn(5, 13, generator=torch.Generator().manual_seed(0))
    mine, theirs = morlax_torch.load(packed), morlax_torch.load(run)
    assert torch.equal(mine(observation, (0.3, 0.7)), theirs(observation, (0.3, 0.7)))
    assert mine.config == theirs.config
    front = Front.load(packed / "front.npz")
    assert front.returns.shape == (512, 2)
    assert np.isfinite(front.hypervolume)


def test_it_leaves_out_what_only_training_needs(run, packed):
    sizes = [(folder / "checkpoints/best.pt").stat().st_size for folder in (run, packed)]
    assert sizes[1] < sizes[0] / 3
    with pytest.raises(MorlaxError, match="no checkpoint"):
        train(load_config(task_values("hopper", "cpu")), run=Run.open(packed))


def test_nothing_is_overwritten(run, packed):
    with pytest.raises(MorlaxError, match="exists already"):
        pack(run, packed)
