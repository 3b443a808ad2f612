"""A packed run is small, gives the same actions, and cannot be resumed."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import tiny

import morlax_torch
from morlax_torch import MorlaxError
from morlax_torch.runs.loading import bookmark, load_front, pack, tradeoff_of
from morlax_torch.runs.run import Run
from morlax_torch.train import train


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    config = tiny(**{"network.hidden": (64,), "network.actor": (64, 64)})
    return train(config, output=tmp_path_factory.mktemp("runs") / "hopper").folder


@pytest.fixture(scope="module")
def packed(run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("packed") / "hopper"
    bookmark(run, "high", (0.3, 0.7))
    pack(run, folder, "cpu")
    return folder


def test_a_packed_run_gives_the_same_actions(run, packed):
    observation = torch.randn(5, 13, generator=torch.Generator().manual_seed(0))
    found, expected = morlax_torch.load(packed), morlax_torch.load(run)
    assert torch.equal(found(observation, (0.3, 0.7)), expected(observation, (0.3, 0.7)))
    assert found.config == expected.config
    assert tradeoff_of("@high", packed) == (0.3, 0.7)


def test_the_front_of_a_run_is_kept_or_evaluated_if_it_has_none(run, packed, tmp_path):
    front = load_front(run)
    np.testing.assert_array_equal(load_front(packed).returns, front.returns)
    shutil.copytree(run, tmp_path / "run")
    file = tmp_path / "run" / "front.npz"
    front._replace(returns=front.returns + 1.0).save(file)  # would be lost by a new evaluation
    kept = pack(tmp_path / "run", tmp_path / "kept", "cpu")
    np.testing.assert_array_equal(kept.returns, front.returns + 1.0)
    file.unlink()
    evaluated = pack(tmp_path / "run", tmp_path / "evaluated", "cpu")
    np.testing.assert_array_equal(evaluated.returns, front.returns)
    assert load_front(tmp_path / "evaluated").checkpoint == "best.pt"


def test_a_packed_run_omits_the_training_state(run, packed):
    sizes = [(folder / "checkpoints/best.pt").stat().st_size for folder in (run, packed)]
    assert sizes[1] < sizes[0] / 3
    with pytest.raises(MorlaxError, match="no checkpoint"):
        train(tiny(), run=Run.open(packed))
    with pytest.raises(MorlaxError, match="exists already"):
        pack(run, packed)


def test_policies_without_a_training_curve_are_packed(run, tmp_path):
    policy, file = morlax_torch.load(run), tmp_path / "saved" / "body.pt"
    file.parent.mkdir()
    morlax_torch.save(policy, file)
    pack(file, tmp_path / "packed", "cpu")
    assert morlax_torch.load(tmp_path / "packed").config == policy.config
