"""`torchrun` starts one training in several processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from same import assert_same

from morlax_torch.runs import checkpoint

TORCHRUN = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
SMALL = (
    *("--env", "hopper", "--device", "cpu", "--worlds", "32", "--horizon", "5"),
    *("--sampling.clusters", "8", "--ppo.minibatches", "2", "--evaluation.tradeoffs", "7"),
    *("--evaluation.every", "1600", "--task.episode-length", "20", "--task.reset-noise", "0.01"),
    "--ppo.no-anneal",
)


def launch(*arguments: str, launcher: tuple[str, ...] = TORCHRUN) -> subprocess.CompletedProcess:
    command = [*launcher, "-m", "morlax_torch.train", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=200)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """Return a folder with a whole run, and with one that was resumed halfway."""
    folder = tmp_path_factory.mktemp("runs")
    for done in (
        launch(*SMALL, "--max-env-steps", "6400", "--output", str(folder / "whole")),
        launch(*SMALL, "--max-env-steps", "3200", "--output", str(folder / "halves")),
        launch("--resume", str(folder / "halves"), "--max-env-steps", "6400"),
    ):
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("hypervolume  front") == 1  # only one process prints
    return folder


def state(run: Path) -> checkpoint.Contents:
    return checkpoint.load(run / "checkpoints" / "latest.pt")


def test_a_resumed_run_of_two_processes_continues_exactly(runs):
    whole, halves = state(runs / "whole"), state(runs / "halves")
    assert_same(whole.learner, halves.learner)
    assert whole.progress.env_steps == 6400 and whole.progress.processes == 2
    steps = [
        [line.split(",")[1] for line in (runs / name / "metrics.csv").read_text().splitlines()]
        for name in ("whole", "halves")
    ]
    assert steps[0] == steps[1] == ["env_steps", "0", "1600", "3200", "4800", "6400"]


def test_each_process_has_worlds_of_its_own(runs):
    learner = state(runs / "whole").learner
    assert learner is not None and len(learner["processes"]) == 1
    assert not torch.equal(learner["observation"], learner["processes"][0]["observation"])


def test_a_run_goes_on_in_one_process_with_new_worlds(runs):
    done = launch(
        *("--resume", str(runs / "halves"), "--max-env-steps", "8000"), launcher=(sys.executable,)
    )
    assert done.returncode == 0, done.stderr
    assert "number of processes: 1 instead of 2, so worlds start anew" in done.stdout
    assert state(runs / "halves").progress.env_steps == 8000


def test_a_mistake_is_told_once(runs):
    done = launch(*SMALL, "--output", str(runs / "whole"))
    assert done.returncode != 0
    assert done.stderr.count("error: ") == 1
    assert "whole exists already" in done.stderr


def test_processes_with_different_configs_do_not_train():
    setting = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": "29617", "WORLD_SIZE": "2"}
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "morlax_torch.train", *SMALL, "--seed", str(rank)],
            env={**os.environ, **setting, "RANK": str(rank), "LOCAL_RANK": str(rank)},
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        for rank in range(2)
    ]
    for process in started:
        message = process.communicate(timeout=100)[1]
        assert process.returncode == 2
        assert "process 1 has another config than process 0" in message
