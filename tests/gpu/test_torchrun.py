"""`torchrun` starts one training in several processes."""

import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen

import pytest
import torch
from programs import Program, ended, free_port, start, start_both
from same import assert_same, csv_rows

from morlax_torch.commands import train
from morlax_torch.runs import checkpoint

TORCHRUN = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
RESTARTING = ("--max-restarts=1", "--monitor-interval=0.2")
STEPS = 8000
SMALL = (
    *("--env", "hopper", "--device", "cpu", "--worlds", "32", "--horizon", "5"),
    *("--sampling.clusters", "8", "--ppo.minibatches", "2", "--evaluation.tradeoffs", "7"),
    *("--evaluation.every", "1600", "--task.episode-length", "20", "--task.reset-noise", "0.01"),
    *("--decay-fraction", "0"),
)


CODE = """
from datetime import timedelta
from morlax_torch.gpu import group
group.PATIENCE = timedelta(seconds=PATIENCE)
from morlax_torch.commands import terminal, train
terminal.cli.run(train.command)
"""
PATIENT, IMPATIENT = (CODE.replace("PATIENCE)", f"{seconds})") for seconds in (100, 1))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Return a run of two processes."""
    folder = tmp_path_factory.mktemp("runs")
    run = folder / "whole"
    words = *SMALL, "--max-env-steps", str(STEPS), "--output", str(run)
    statuses, output, errors = ended(start_both(PATIENT, folder, words))
    assert statuses == [0, 0], errors
    assert output.count("hypervolume  front") == 1  # only one process prints
    return run


def state(run: Path) -> checkpoint.Contents:
    return checkpoint.load(run / "checkpoints" / "latest.pt")


@pytest.mark.slow
def test_a_run_goes_on_in_one_process_with_new_worlds(whole, tmp_path, capsys):
    run = shutil.copytree(whole, tmp_path / "run")
    train.command(["--resume", str(run), "--max-env-steps", str(STEPS + 1600)])
    assert "number of processes: 1 instead of 2, so worlds start anew" in capsys.readouterr().out
    assert state(run).progress.env_steps == STEPS + 1600


BROKEN = """
import os
from morlax_torch import envs

class Broken(envs.get("hopper")):
    def terms(self):
        self.steps = getattr(self, "steps", 0) + 1
        broken = os.environ.get("RANK") == "1" and self.steps > 30
        return {name: x / 0 if broken else x for name, x in super().terms().items()}
"""


def ranks(launcher: int) -> dict[int, int]:
    """Return the processes of a launcher, by rank."""
    found = {}
    for child in Path(f"/proc/{launcher}/task/{launcher}/children").read_text().split():
        variables = Path(f"/proc/{child}/environ").read_text().split("\0")
        found |= {int(each[5:]): int(child) for each in variables if each.startswith("RANK=")}
    return found


needs_proc = pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc")


@needs_proc
@pytest.mark.slow
def test_a_run_goes_on_exactly_after_a_process_was_killed(whole, tmp_path):
    run, limit = tmp_path / "run", ("--max-env-steps", str(STEPS))
    command = [*TORCHRUN, *RESTARTING, "-m", "morlax_torch.train", *SMALL, *limit]
    command += ["--output", str(run)]
    with Popen(command, stderr=PIPE, text=True) as launcher:
        wait_for_lines(run, 3, [launcher])
        os.kill(ranks(launcher.pid)[1], signal.SIGKILL)
        _, errors = launcher.communicate(timeout=100)
    assert launcher.returncode == 0 and "failed (exitcode" in errors, errors
    assert_same(state(whole).learner, state(run).learner)
    assert state(whole).progress.env_steps == STEPS and state(whole).progress.processes == 2
    columns = [
        [(row["env_steps"], row["hypervolume"]) for row in csv_rows(folder / "metrics.csv")]
        for folder in (whole, run)
    ]
    assert columns[0] == columns[1]
    assert [int(steps) for steps, _ in columns[0]] == list(range(0, STEPS + 1, 1600))


two_gpus = pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")


@needs_proc
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("killed", "device"),
    [(0, "cpu"), (1, "cpu"), pytest.param(1, "cuda", marks=[pytest.mark.gpu, two_gpus])],
)
def test_launchers_on_several_hosts_go_on_after_a_process_was_killed(tmp_path, killed, device):
    run, address = tmp_path / "run", f"127.0.0.1:{free_port()}"
    command = [
        *(sys.executable, "-m", "torch.distributed.run", "--nnodes=2", "--nproc-per-node=1"),
        *("--rdzv-backend=c10d", f"--rdzv-endpoint={address}", "--rdzv-id=7"),
        *(*RESTARTING, "-m", "morlax_torch.train"),
        *("--env", "hopper", "--device", device, *SMALL[4:], "--output", str(run)),
    ]
    launchers = [
        Popen(command, env={**os.environ, "CUDA_VISIBLE_DEVICES": gpu}, stderr=DEVNULL)
        for gpu in "01"
    ]
    try:
        wait_for_lines(run, 3, launchers)
        places = {rank: child for one in launchers for rank, child in ranks(one.pid).items()}
        # the other one must not end by itself: its launcher then counts no restart
        os.kill(places[1 - killed], signal.SIGSTOP)
        os.kill(places[killed], signal.SIGKILL)
        time.sleep(3)
        os.kill(places[1 - killed], signal.SIGCONT)
        wait_for_lines(run, len((run / "metrics.csv").read_text().splitlines()) + 2, launchers)
    finally:
        for one in launchers:
            one.terminate()
            one.wait()


def wait_for_lines(run: Path, number: int, running: Sequence[Popen | Program]) -> None:
    metrics = run / "metrics.csv"
    until(lambda: metrics.exists() and len(metrics.read_text().splitlines()) >= number, running)


def until(happened: Callable[[], bool], running: Sequence[Popen | Program]) -> None:
    """Wait until `happened` returns true, while processes run."""
    end = time.monotonic() + 100
    while not happened():
        assert time.monotonic() < end
        assert all(one.poll() is None for one in running)
        time.sleep(0.05)


@pytest.mark.slow
def test_a_signal_to_one_process_ends_all(tmp_path):
    both = start_both(PATIENT, tmp_path, (*SMALL, "--output", str(tmp_path / "run")))
    wait_for_lines(tmp_path / "run", 3, both)
    both[1].terminate()
    _, output, _ = ended(both)
    assert output.count("interrupted: ") == 1
    assert state(tmp_path / "run").progress.env_steps > 1600


@pytest.mark.slow
def test_numbers_that_one_process_cannot_learn_from_end_all(tmp_path):
    (tmp_path / "broken.py").write_text(BROKEN)
    task = ("--env", f"{tmp_path / 'broken.py'}:Broken", "--output", str(tmp_path / "run"))
    statuses, _, errors = ended(start_both(PATIENT, tmp_path, (*task, *SMALL[2:])))
    assert all(statuses)
    assert "error: " in errors and "Traceback" not in errors
    assert "every world blew up" in errors or "not finite" in errors
    assert all(value.isfinite().all() for value in state(tmp_path / "run").agent.values())


WAITING = """
from datetime import timedelta
from torch.distributed import TCPStore
from morlax_torch.commands.terminal import process

process.STUCK = 0.5
with process.exiting_on_signals():
    process.exit_when_stuck()
    store = TCPStore("127.0.0.1", 0, is_master=True, timeout=timedelta(seconds=90))
    print("waiting", flush=True)
    store.get("what nobody sets")  # Python handles no signal meanwhile
"""


@pytest.mark.slow
def test_a_process_that_waits_for_one_that_has_ended_heeds_a_signal(tmp_path):
    program, output = Program(WAITING, tmp_path), tmp_path / "stdout"
    until(lambda: output.exists() and output.read_text() == "waiting\n", [program])
    program.terminate()
    assert program.ended(80)[0] == 143


@pytest.mark.slow
def test_a_missing_process_is_told(tmp_path):
    status, _, message = start(IMPATIENT, tmp_path, 0, free_port(), SMALL).ended(100)
    assert status == 2
    assert "the 2 processes of this run did not find each other" in message


@pytest.mark.slow
def test_processes_with_different_configs_do_not_train(tmp_path):
    port = free_port()
    seeds = [(*SMALL, "--seed", str(seed)) for seed in range(2)]
    both = [start(PATIENT, tmp_path, rank, port, words) for rank, words in enumerate(seeds)]
    for process in both:
        status, _, message = process.ended(100)
        assert status == 2
        assert "process 1 has another config than process 0" in message
