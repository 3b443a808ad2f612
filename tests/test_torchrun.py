"""`torchrun` starts one training in several processes."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import torch
from same import assert_same

from morlax_torch import MorlaxError
from morlax_torch.commands import train
from morlax_torch.runs import checkpoint
from morlax_torch.terminal import arguments

TORCHRUN = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2")
SMALL = (
    *("--env", "hopper", "--device", "cpu", "--worlds", "32", "--horizon", "5"),
    *("--sampling.clusters", "8", "--ppo.minibatches", "2", "--evaluation.tradeoffs", "7"),
    *("--evaluation.every", "1600", "--task.episode-length", "20", "--task.reset-noise", "0.01"),
    *("--ppo.decay-fraction", "0"),
)


def launch(*arguments: str, launcher: tuple[str, ...] = TORCHRUN) -> subprocess.CompletedProcess:
    command = [*launcher, "-m", "morlax_torch.train", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=200)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """Return a folder with a whole run, and with one that was resumed halfway."""
    folder = tmp_path_factory.mktemp("runs")
    for done in (
        launch(*SMALL, "--max-env-steps", "4800", "--output", str(folder / "whole")),
        launch(*SMALL, "--max-env-steps", "1600", "--output", str(folder / "halves")),
        launch("--resume", str(folder / "halves"), "--max-env-steps", "4800"),
    ):
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("hypervolume  front") == 1  # only one process prints
    return folder


def state(run: Path) -> checkpoint.Contents:
    return checkpoint.load(run / "checkpoints" / "latest.pt")


def test_a_resumed_run_of_two_processes_continues_exactly(runs):
    whole, halves = state(runs / "whole"), state(runs / "halves")
    assert_same(whole.learner, halves.learner)
    assert whole.progress.env_steps == 4800 and whole.progress.processes == 2
    steps = [
        [line.split(",")[1] for line in (runs / name / "metrics.csv").read_text().splitlines()]
        for name in ("whole", "halves")
    ]
    assert steps[0] == steps[1] == ["env_steps", "0", "1600", "3200", "4800"]


def test_each_process_has_worlds_of_its_own(runs):
    learner = state(runs / "whole").learner
    assert learner is not None and len(learner["processes"]) == 1
    assert not torch.equal(learner["observation"], learner["processes"][0]["observation"])


def test_a_run_goes_on_in_one_process_with_new_worlds(runs, capsys):
    train.command(["--resume", str(runs / "halves"), "--max-env-steps", "6400"])
    assert "number of processes: 1 instead of 2, so worlds start anew" in capsys.readouterr().out
    assert state(runs / "halves").progress.env_steps == 6400


BROKEN = """
import os
from morlax_torch import envs

class Broken(envs.get("hopper")):
    def terms(self):
        self.steps = getattr(self, "steps", 0) + 1
        broken = os.environ.get("RANK") == "1" and self.steps > 30
        return {name: x / 0 if broken else x for name, x in super().terms().items()}
"""


@pytest.fixture
def training(tmp_path, request) -> Iterator[tuple[subprocess.Popen, Path]]:
    """Start two processes that train for ever, and wait for their second evaluation."""
    run = tmp_path / "run"
    command = [*TORCHRUN, *request.param, "-m", "morlax_torch.train", *SMALL, "--output", str(run)]
    started = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_for_lines(run, 3, [started])
    yield started, run
    if started.poll() is None:
        os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


def ranks(launcher: int) -> dict[int, int]:
    """Return the processes of a launcher, by rank."""
    found = {}
    for child in Path(f"/proc/{launcher}/task/{launcher}/children").read_text().split():
        variables = Path(f"/proc/{child}/environ").read_text().split("\0")
        found |= {int(each[5:]): int(child) for each in variables if each.startswith("RANK=")}
    return found


needs_proc = pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc")


@needs_proc
@pytest.mark.parametrize(
    "training", [("--max-restarts=1", "--monitor-interval=0.2")], indirect=True
)
def test_training_goes_on_after_a_process_was_killed(training, runs):
    launcher, run = training
    os.kill(ranks(launcher.pid)[1], signal.SIGKILL)
    wait_for_lines(run, len((run / "metrics.csv").read_text().splitlines()) + 2, [launcher])
    os.kill(ranks(launcher.pid)[0], signal.SIGTERM)
    launcher.communicate(timeout=100)
    table = (run / "metrics.csv").read_text()
    steps = [int(line.split(",")[1]) for line in table.splitlines()[1:]]
    assert steps == list(range(0, 1600 * len(steps), 1600))
    whole = (runs / "whole" / "metrics.csv").read_text().splitlines()[:4]
    # as if no process had been killed
    assert hypervolumes(table.splitlines()[:4]) == hypervolumes(whole)


two_gpus = pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two GPUs")


@needs_proc
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("killed", "device"),
    [
        (0, "cpu"),
        (1, "cpu"),
        pytest.param(1, "cuda", marks=[pytest.mark.gpu, two_gpus]),
    ],
)
def test_launchers_on_several_hosts_go_on_after_a_process_was_killed(tmp_path, killed, device):
    run, address = tmp_path / "run", f"127.0.0.1:{free_port()}"
    command = [
        *(sys.executable, "-m", "torch.distributed.run", "--nnodes=2", "--nproc-per-node=1"),
        *("--rdzv-backend=c10d", f"--rdzv-endpoint={address}", "--rdzv-id=7"),
        *("--max-restarts=1", "--monitor-interval=0.2", "-m", "morlax_torch.train"),
        *("--env", "hopper", "--device", device, *SMALL[4:], "--output", str(run)),
    ]
    launchers = [
        subprocess.Popen(
            command, env={**os.environ, "CUDA_VISIBLE_DEVICES": gpu}, stderr=subprocess.DEVNULL
        )
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


def wait_for_lines(run: Path, number: int, launchers: Sequence[subprocess.Popen]) -> None:
    metrics, end = run / "metrics.csv", time.monotonic() + 100
    while not metrics.exists() or len(metrics.read_text().splitlines()) < number:
        assert time.monotonic() < end
        assert all(one.poll() is None for one in launchers)
        time.sleep(0.05)


def hypervolumes(lines: list[str]) -> list[str]:
    column = lines[0].split(",").index("hypervolume")
    return [line.split(",")[column] for line in lines]


@needs_proc
@pytest.mark.parametrize("training", [()], indirect=True)
def test_a_signal_to_one_process_ends_all(training):
    launcher, run = training
    os.kill(ranks(launcher.pid)[1], signal.SIGTERM)
    output, _ = launcher.communicate(timeout=100)
    assert output.count("interrupted: ") == 1
    assert state(run).progress.env_steps > 1600


def test_numbers_that_one_process_cannot_learn_from_end_all(tmp_path):
    (tmp_path / "broken.py").write_text(BROKEN)
    task = ("--env", f"{tmp_path / 'broken.py'}:Broken", "--output", str(tmp_path / "run"))
    done = launch(*task, *SMALL[2:])
    assert done.returncode != 0
    assert done.stderr.count("error: ") == 1
    assert "every world blew up" in done.stderr or "not finite" in done.stderr
    assert all(value.isfinite().all() for value in state(tmp_path / "run").agent.values())


def test_restarts_need_a_folder(monkeypatch):
    monkeypatch.setattr(arguments, "MAY_RESTART", True)
    with pytest.raises(MorlaxError, match="--max-restarts needs --output FOLDER, to go on from"):
        train.read(SMALL)


@pytest.mark.slow
@pytest.mark.long
def test_restarts_do_not_continue_a_run_of_another_launch(runs):
    before = state(runs / "whole").progress
    launcher = (*TORCHRUN, "--max-restarts=1", "--monitor-interval=0.2")
    done = launch(*SMALL, "--output", str(runs / "whole"), launcher=launcher)
    assert done.returncode != 0
    assert "whole exists already" in done.stderr
    assert state(runs / "whole").progress == before


WAITING = """
from datetime import timedelta
from torch.distributed import TCPStore
from morlax_torch.terminal.interrupt import exiting_on_signals, exiting_when_stuck

with exiting_on_signals(), exiting_when_stuck():
    store = TCPStore("127.0.0.1", 0, is_master=True, timeout=timedelta(seconds=90))
    print("waiting", flush=True)
    store.get("what nobody sets")  # Python handles no signal meanwhile
"""


def test_a_process_that_waits_for_one_that_has_ended_heeds_a_signal():
    command = [sys.executable, "-c", WAITING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "waiting\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=80) == 143


def by_hand(rank: int, port: int, *arguments: str) -> subprocess.Popen:
    """Start one of two processes that train, which wait for each other for 3 s."""
    places = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2"}
    impatient = (
        "from datetime import timedelta; from morlax_torch.gpu import group; "
        "group.PATIENCE = timedelta(seconds=3); "
        "from morlax_torch.commands.train import main; main()"
    )
    return subprocess.Popen(
        [sys.executable, "-c", impatient, *arguments],
        env={**os.environ, **places, "RANK": str(rank), "LOCAL_RANK": str(rank)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def test_a_missing_process_is_told():
    first = by_hand(0, free_port(), *SMALL)
    message = first.communicate(timeout=100)[1]
    assert first.returncode == 2
    assert "the 2 processes of this run did not find each other" in message


def test_processes_with_different_configs_do_not_train():
    port = free_port()
    for process in [by_hand(rank, port, *SMALL, "--seed", str(rank)) for rank in range(2)]:
        message = process.communicate(timeout=100)[1]
        assert process.returncode == 2
        assert "process 1 has another config than process 0" in message


def test_a_host_without_the_folder_of_a_resumed_run_is_told(runs):
    port, longer = free_port(), ("--max-env-steps", "9600")
    first = by_hand(0, port, "--resume", str(runs / "whole"), *longer)
    message = by_hand(1, port, *SMALL, *longer).communicate(timeout=100)[1]
    assert "process 0 resumes a run whose folder process 1 cannot find" in message
    first.kill()
    first.communicate()
