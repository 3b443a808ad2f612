"""Kill training at random moments, resume it, and compare it with an uninterrupted run.

    python benchmarks/kills.py --kills 15

Training on the CPU repeats bit for bit, so checkpoints, metrics and the front must be equal to the
last bit, except for measured times. 15 kills of each task take about half an hour on two CPU cores;
if other programs use them, OMP_NUM_THREADS=1 is faster. Do not change the code meanwhile: every
session imports it anew.

The table also counts kills before there was a run to resume (early), temporary files that kills
left (drafts), and those that are still there when the resumed run ends (left over).
"""

import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import tyro
import yaml
from rich.table import Table
from row_files import read_rows
from torch import Tensor

from morlax_torch.commands.terminal.cli import console

KILLS_PER_RUN = 3
FILES = ("checkpoints/latest.pt", "checkpoints/best.pt", "metrics.csv", "front.npz")
TIMES = ("train_seconds", "total_seconds", "steps_per_second")

SMALL: dict[str, Any] = {
    "device": "cpu",
    "worlds": 32,
    "horizon": 10,
    "sampling": {"clusters": 8},
    "ppo": {"minibatches": 2, "epochs": 2},
    "evaluation": {"every": 1600, "tradeoffs": 8},
}
RANDOMIZED = {
    "reset_noise": 0.02,
    "stagger": True,
    "randomization": {
        "friction": [0.5, 1.5],
        "mass": [0.8, 1.2],
        "strength": [0.8, 1.2],
        "fields": {"dof_damping": [0.5, 2.0]},
        "observation_noise": {"position": 0.01, "velocity": 0.1},
        "action_delay": [0, 2],
        "push": 0.5,
        "push_every": 20,
    },
}
BRUCE = {"draw_commands": True, "redraw_every": 10, "noise": 1.0, "randomize": True}
TASKS: dict[str, dict[str, Any]] = {  # names and task options
    "cheetah": {},
    "hopper": RANDOMIZED,
    "bruce": {"stagger": True, **BRUCE},
    "crawler.py:Crawler": {"stagger": True, "reset_noise": 0.02},
}
SLOWER = {"bruce": 4}  # times, so its runs are that much shorter
PAGE = Path(__file__).parents[1] / "docs" / "your-own-robot.md"
OWN_ROBOT = re.compile(r"```\w+\n((?:# |<!-- )(crawler\.\w+)\b.*?)```", re.DOTALL)


class Session(NamedTuple):
    """One process that trains, until it ends or is killed."""

    seconds: float
    status: int | None  # None: killed
    evaluations: int | None  # that the run then has (None: there is no run yet)
    unfinished: int  # temporary files and folders that it leaves

    def __str__(self) -> str:
        reached = "no run yet" if self.evaluations is None else f"evaluations: {self.evaluations}"
        return f"{self.seconds:.1f} s ({reached})"


class Trial(NamedTuple):
    """A run that was killed, resumed and finished, against the uninterrupted one."""

    killed: list[Session]
    differences: list[str]
    left_over: list[str]  # files that the uninterrupted run does not have

    def __str__(self) -> str:
        moments = ", ".join(map(str, self.killed)) or "never"
        left = f", left over: {', '.join(self.left_over)}" if self.left_over else ""
        return f"killed after {moments}: {'; '.join(self.differences) or 'equal'}{left}"


def main(kills: int = 15, max_env_steps: int = 32_000) -> None:
    """Kill and resume; exits with status 1 if a run differs from the uninterrupted one.

    Args:
        kills: Number of kills per task, at most three of them in one run.
        max_env_steps: Length of each run, in environment steps; BRUCE's are a quarter as long.
    """
    root = Path(tempfile.mkdtemp(prefix="kills-"))
    table = Table()
    for column in ("task", "runs", "kills", "early", "drafts", "left over", "differ"):
        first = column == "task"
        table.add_column(column, justify="left" if first else "right", no_wrap=first)
    different = 0
    for task in TASKS:
        trials = try_task(task, kills, max_env_steps, root / task.rpartition(":")[2])
        killed = [session for trial in trials for session in trial.killed]
        counts = (
            len(trials),
            len(killed),
            sum(session.evaluations is None for session in killed),
            sum(session.unfinished for session in killed),
            sum(len(trial.left_over) for trial in trials),
            sum(bool(trial.differences) for trial in trials),
        )
        table.add_row(task, *map(str, counts))
        different += counts[-1]
    console.print(table)
    if different:
        sys.exit(f"{different} runs differ; they are in {root}")
    shutil.rmtree(root)


def try_task(task: str, kills: int, max_env_steps: int, folder: Path) -> list[Trial]:
    """Run a task once without kills, then again and again until there were `kills`.

    Args:
        task: name of the task, of TASKS.
        kills: how often to kill, over all runs.
        max_env_steps: length of each run.
        folder: where to put the runs; made here.
    """
    folder.mkdir()
    for text, name in OWN_ROBOT.findall(PAGE.read_text()):
        (folder / name).write_text(text)
    steps = max_env_steps // SLOWER.get(task, 1)
    config = {**SMALL, "max_env_steps": steps, "task": {"episode_length": 50, **TASKS[task]}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    whole = folder / "uninterrupted"
    life = train(task, whole, None)
    if life.status:
        sys.exit(f"training failed: {_last_line(whole)}")
    console.print(f"{task}: {life} without kills")
    trials, seconds = [], life.seconds
    while kills > 0:
        place = folder / f"{len(trials) + 1}"
        killed, last = train_with_kills(task, place, min(kills, KILLS_PER_RUN), seconds)
        kills -= len(killed)
        if not killed:  # the machine may be less busy than before
            seconds = min(seconds, last.seconds)
        found = [f"exit status {last.status}: {_last_line(place)}"] if last.status else []
        found += differences(whole / "run", place / "run")
        trials.append(Trial(killed, found, sorted(_names(place) - _names(whole))))
        console.print(f"{task} {len(trials)}: {trials[-1]}")
    return trials


def train_with_kills(
    task: str, place: Path, kills: int, seconds: float
) -> tuple[list[Session], Session]:
    """Train, resuming after at most `kills` kills; returns the killed sessions and the last one.

    A session that ends before its random moment, within `seconds`, is not killed.
    """
    killed = []
    while True:
        moment = random.uniform(0, seconds) if len(killed) < kills else None
        session = train(task, place, moment)
        if session.status is not None:
            return killed, session
        killed.append(session)


def train(task: str, place: Path, seconds: float | None) -> Session:
    """Start a run in `place`, or resume the one that is there, and kill it after `seconds`."""
    place.mkdir(exist_ok=True)
    run, before = place / "run", _unfinished(place)
    new = ("--env", task, "--config", "config.yaml", "--output", str(run))
    arguments = ("--resume", str(run), "--trust") if run.exists() else new
    began = time.monotonic()
    with (
        _log(place).open("ab") as log,
        subprocess.Popen(
            [sys.executable, "-m", "morlax_torch.train", *arguments],
            cwd=place.parent,
            stdout=log,
            stderr=subprocess.STDOUT,
        ) as process,
    ):
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            status = None if process.wait() else 0  # 0: it ended just before
    passed = time.monotonic() - began
    evaluations = len(read_rows(run / "metrics.csv")) if run.exists() else None
    return Session(passed, status, evaluations, len(_unfinished(place) - before))


def differences(one: Path, other: Path) -> list[str]:
    """Compare the files of two runs to the last bit; returns what differs."""
    found = []
    for name in FILES:
        values = [dict(_flat(_contents(run / name))) for run in (one, other)]
        names = [n for n in values[0] | values[1] if values[0].get(n) != values[1].get(n)]
        if names:
            found.append(f"{name} differs in {len(names)} values, such as {names[0] or 'all'}")
    return found


def _contents(path: Path) -> Any:
    """Return what a file holds, or what is wrong with it."""
    try:
        match path.suffix:
            case ".pt":
                return torch.load(path, weights_only=True)
            case ".npz":
                with np.load(path) as arrays:
                    return dict(arrays)
            case _:
                return read_rows(path)
    except Exception as error:  # numpy, zip and torch each fail in their own way
        return f"{type(error).__name__}: {error}"


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield every nested value but times by its dotted name, arrays as bytes."""
    if isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            if key not in TIMES:
                yield from _flat(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, Tensor | np.ndarray):
        array = np.asarray(value)
        yield name, (array.dtype, array.shape, array.tobytes())
    else:
        yield name, repr(value)


def _names(place: Path) -> set[str]:
    """Return the files and folders in `place`, without events, of which each session has a file."""
    paths = {str(path.relative_to(place)) for path in place.rglob("*")}
    return {path for path in paths if "events." not in path}


def _unfinished(place: Path) -> set[str]:
    return {name for name in _names(place) if name.endswith(".tmp")}


def _log(place: Path) -> Path:
    return place.with_suffix(".log")


def _last_line(place: Path) -> str:
    return _log(place).read_text().strip().rpartition("\n")[2]


if __name__ == "__main__":
    tyro.cli(main)
