"""Ten minutes of training: does memory, or anything else, grow?

    python benchmarks/soak.py --minutes 10

A cheap task is evaluated after every second iteration, so that pictures, rows and events pile up.
Memory settles in the first minute or two, so shorter runs say little. Needs Linux, for its /proc.
"""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import NamedTuple

import tyro
from rich.table import Table

from morlax_torch.commands.terminal.cli import console

SAMPLES, SHOWN = 240, 20
MOST_GROWTH = 5.0  # % of memory
TRAIN = (
    *(sys.executable, "-m", "morlax_torch.train", "--env", "cheetah", "--device", "cpu"),
    *("--worlds", "64", "--horizon", "10", "--ppo.minibatches", "2"),
    *("--max-env-steps", "1000000000", "--evaluation.every", "1280"),
    *("--evaluation.tradeoffs", "16", "--task.episode-length", "50"),
)


class Sample(NamedTuple):
    """One measurement of the process and its run folder."""

    seconds: float
    evaluations: int
    memory: float  # MiB resident
    files: int  # open
    threads: int
    folder: float  # MB
    events: float  # MB


def main(minutes: float = 10.0) -> None:
    """Train and watch; exits with status 1 if memory, open files or threads grew.

    Args:
        minutes: How long to watch, from the second evaluation on.
    """
    if not Path("/proc/self/status").is_file():
        sys.exit("soak.py reads /proc, which only Linux has.")
    with tempfile.TemporaryDirectory() as name:
        samples = watch(Path(name), 60 * minutes)
    table = Table()
    for column in ("s", "evaluations", "RSS MiB", "files", "threads", "folder MB", "events MB"):
        table.add_column(column, justify="right")
    for sample in samples[:: max(1, len(samples) // SHOWN)]:
        seconds, evaluations, memory, files, threads, folder, events = sample
        counts = (str(evaluations), f"{memory:.1f}", str(files), str(threads))
        table.add_row(f"{seconds:.0f}", *counts, f"{folder:.2f}", f"{events:.2f}")
    console.print(table)
    sys.exit(0 if judge(samples) else 1)


def watch(folder: Path, seconds: float) -> list[Sample]:
    """Train in `folder` for some seconds and return samples at equal intervals."""
    run, log = folder / "run", folder / "log.txt"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*TRAIN, "--output", str(run)], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        while _evaluations(run) < 2:
            _check_running(process, log)
            time.sleep(0.1)
        began, samples = time.monotonic(), []
        for number in range(SAMPLES):
            time.sleep(max(0.0, began + number * seconds / SAMPLES - time.monotonic()))
            _check_running(process, log)
            samples.append(_sample(process.pid, run, time.monotonic() - began))
    finally:
        process.kill()
        process.wait()
    return samples


def judge(samples: list[Sample]) -> bool:
    """Print how much grew between the first and the last third; returns whether it is too much.

    The smallest number of files and threads counts, because more are open while a file is written.
    """
    third = len(samples) // 3
    first, last = samples[:third], samples[-third:]
    memory = [median(sample.memory for sample in part) for part in (first, last)]
    growth = 100 * (memory[1] / memory[0] - 1)
    files, threads = (
        min(getattr(s, name) for s in last) - min(getattr(s, name) for s in first)
        for name in ("files", "threads")
    )
    begin, end = samples[0], samples[-1]
    evaluations = end.evaluations - begin.evaluations
    folder, events = (
        1000 * (getattr(end, name) - getattr(begin, name)) / max(1, evaluations)
        for name in ("folder", "events")
    )
    rates = [
        60 * (part[-1].evaluations - part[0].evaluations) / (part[-1].seconds - part[0].seconds)
        for part in (first, last)
    ]
    steady = growth <= MOST_GROWTH and files <= 0 and threads <= 0
    console.print(
        f"{'steady' if steady else 'GROWS'}: RSS {growth:+.2f} %, files {files:+d}, threads "
        f"{threads:+d}; folder {folder:+.1f} kB per evaluation ({events:.1f} of them events); "
        f"evaluations per minute {rates[0]:.0f}, in the end {rates[1]:.0f}"
    )
    return steady


def _sample(process: int, run: Path, seconds: float) -> Sample:
    proc = Path(f"/proc/{process}")
    status = dict(
        line.split(":", 1) for line in (proc / "status").read_text().splitlines() if ":" in line
    )
    sizes = {}
    for path in run.rglob("*"):
        with suppress(FileNotFoundError):  # a temporary file that has just replaced its target
            sizes[path] = path.stat().st_size / 1e6
    return Sample(
        seconds,
        _evaluations(run),
        int(status["VmRSS"].split()[0]) / 1024,
        len(os.listdir(proc / "fd")),
        int(status["Threads"]),
        sum(sizes.values()),
        sum(size for path, size in sizes.items() if path.name.startswith("events.")),
    )


def _evaluations(run: Path) -> int:
    metrics = run / "metrics.csv"
    return len(metrics.read_text().splitlines()) - 1 if metrics.is_file() else 0


def _check_running(process: subprocess.Popen, log: Path) -> None:
    if process.poll() is not None:
        sys.exit(f"training ended with status {process.returncode}:\n{log.read_text()}")


if __name__ == "__main__":
    tyro.cli(main)
