"""Measure what the seconds of a training command are spent on, and draw them.

    python benchmarks/breakdown.py rows.csv --env cheetah ant --seconds 10 --figure breakdown.png

A part lasts until the next one is announced (`host.phases`). Files are written beside training.
"""

import csv
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch
import tyro
from matplotlib.figure import Figure
from row_files import write_rows

from morlax_torch.commands.terminal import cli

PARTS = {  # first words of phases
    "import": "start Python, import",
    "building": "build worlds",
    "compiling": "compile, record graphs",
    "evaluating": "evaluate",
    "training": "train",
    "exit": "write the rest, exit",
}
TRAINING = """
import csv, os, time
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.arguments import read
from morlax_torch.host.phases import heard_by
from morlax_torch.train import train
marks = [("import", float(os.environ["BEGAN"]))]
def note(name, share):
    if name.split()[0] != marks[-1][0]:
        marks.append((name.split()[0], time.time()))
def command(words):
    with heard_by(note):
        config, run, start = read(words)
        train(config, run, start.output)
    marks.append(("exit", time.time()))
    with open(os.environ["MARKS"], "w", newline="") as file:
        csv.writer(file).writerows(marks)
cli.run(command)
"""


def main(
    output: tyro.conf.Positional[Path],
    env: tuple[str, ...] = ("cheetah", "walker", "ant", "hopper", "humanoid"),
    seconds: float = 10.0,
    seed: int = 100,
    figure: Path | None = None,
) -> None:
    """Write a row per task and part.

    Args:
        output: CSV file.
        env: Tasks.
        seconds: Of training.
        seed: Of the runs.
        figure: Image to draw.
    """
    card = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "CPU"
    rows = []
    for task in env:
        spent = measured(task, seconds, seed)
        rows += [(card, task, part, f"{spent.get(part, 0.0):.3f}") for part in PARTS]
    columns = ("card", "task", "part", "seconds")
    write_rows(output, [dict(zip(columns, row, strict=True)) for row in rows])
    if figure:
        drawn(rows).savefig(figure, dpi=150)


def measured(task: str, seconds: float, seed: int) -> dict[str, float]:
    """Train in a process; returns the seconds of each part."""
    with tempfile.TemporaryDirectory() as folder:
        # a script of this name begins and ends as the command does
        marks, script = Path(folder, "marks.csv"), Path(folder, "morlax")
        script.write_text(TRAINING)
        words = ["--env", task, "--max-seconds", str(seconds), "--seed", str(seed)]
        command = [sys.executable, str(script), *words, "--output", f"{folder}/run"]
        began = time.time()
        environment = {**os.environ, "BEGAN": str(began), "MARKS": str(marks)}
        subprocess.run(command, env=environment, check=True)
        ended = time.time()
        with marks.open(newline="") as file:
            times = [(name, float(at)) for name, at in csv.reader(file)]
    spent: dict[str, float] = {}
    for (name, start), (_, end) in zip(times, [*times[1:], ("", ended)], strict=True):
        spent[name] = spent.get(name, 0.0) + end - start
    return spent


def drawn(rows: Sequence[tuple[str, str, str, str]]) -> Figure:
    """Return bars of the parts, one per task."""
    figure = Figure(figsize=(7, 2.4), layout="constrained")
    axes, tasks = figure.subplots(), [*dict.fromkeys(task for _, task, _, _ in rows)]
    left = [0.0] * len(tasks)
    for part, name in PARTS.items():
        widths = [float(seconds) for _, _, each, seconds in rows if each == part]
        axes.barh(tasks, widths, left=left, label=name)
        left = [x + width for x, width in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("seconds since the command")
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
