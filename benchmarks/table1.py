"""How long the published command takes to the hypervolumes of the paper's Table I.

    python benchmarks/table1.py --env hopper --limits 5 6 7 8 --output table1-h200  # to choose one
    python benchmarks/table1.py --env hopper --limits 7 --seeds 200 201 202 203 204 --output ...

Each row is one `python -m morlax_torch.train --env TASK --max-seconds LIMIT --seed SEED`, timed
from its start to its exit. Its checkpoint is then loaded and evaluated anew. A limit reaches a
target if the median over the seeds of these new hypervolumes does. Limits are tried from the
shortest on, and one that cannot reach the target any more is left early; a single limit never is.
Run each task once before, so that its kernels are compiled.

Appends to OUTPUT.csv, where rows that exist are not measured again, and writes the table to
OUTPUT.md. To write the table from the rows alone, pass --env without a task.
"""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import tyro
from row_files import append_rows, markdown, read_tuples

from morlax_torch.commands.terminal.cli import console
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import best_row, hypervolume_of, read_rows

Goal = Literal["hyper-morl", "morlax"]

TARGETS: dict[Goal, dict[str, float]] = {  # the highest hypervolumes in the paper's Table I
    "hyper-morl": {
        "cheetah": 5.58e6,
        "walker": 5.28e6,
        "ant": 2.70e7,
        "hopper": 6.0e6,
        "humanoid": 0.74e6,
    },
    "morlax": {
        "cheetah": 5.78e6,
        "walker": 6.48e6,
        "ant": 2.81e7,
        "hopper": 1.48e7,
        "humanoid": 5.45e6,
    },
}


class Row(NamedTuple):
    """One command, and a new evaluation of its best checkpoint."""

    env: str
    max_seconds: float
    seed: int
    command_seconds: float  # from the command's start to its exit
    first_row_seconds: float  # to its first evaluation: step 0, or a short run's end
    env_steps: int
    hypervolume: float  # of the new evaluation
    printed_hypervolume: float  # of the best checkpoint, as the command printed it
    paper_protocol: float  # hypervolume of the new evaluation by the paper's protocol


def main(
    env: tuple[str, ...] = tuple(TARGETS["hyper-morl"]),
    limits: tuple[float, ...] = (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30),
    seeds: tuple[int, ...] = (100, 101, 102, 103, 104),
    goal: Goal = "hyper-morl",
    device: str | None = None,
    output: Path = Path("table1"),
) -> None:
    """Find the shortest training time that reaches a target, and write the table.

    Args:
        env: Tasks to train; none: only write the table.
        limits: Training times to try, in seconds.
        seeds: Random seeds, other than those that configs were tuned with.
        goal: Whose highest hypervolume is the target.
        device: cuda or cpu (None: CUDA if available).
        output: Path of the output files, without a suffix.
    """
    path = Path(f"{output}.csv")
    rows = {(row.env, row.max_seconds, row.seed): row for row in read_tuples(Row, path)}
    for task in env:
        for limit in sorted(limits):
            target, volumes = TARGETS[goal][task], []
            for seed in seeds:
                row = rows.get((task, limit, seed))
                if row is None:
                    row = rows[task, limit, seed] = measured(task, limit, seed, device)
                    append_rows(path, [row._asdict()])
                    console.print(str(row))
                volumes.append(row.hypervolume)
                missed = sum(volume < target for volume in volumes)
                if len(limits) > 1 and missed > len(seeds) // 2:
                    break
            if len(volumes) == len(seeds) and median(volumes) >= target:
                break
    table = reached(list(rows.values()), len(seeds))
    console.print(table)
    Path(f"{output}.md").write_text(table)


def measured(task: str, limit: float, seed: int, device: str | None) -> Row:
    """Run the command, load its best checkpoint and evaluate it."""
    device_options = ("--device", device) if device else ()
    with TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        options = (
            "--env",
            task,
            "--max-seconds",
            f"{limit:g}",
            "--seed",
            str(seed),
            *device_options,
        )
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "morlax_torch.train", *options, "--output", str(run)],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        seconds = time.perf_counter() - start
        history = read_rows(run / "metrics.csv")
        latched, paper = (
            evaluate(run, protocol=protocol, device=device).hypervolume
            for protocol in ("latched", "paper")
        )
    return Row(
        task,
        limit,
        seed,
        round(seconds, 2),
        float(history[0]["total_seconds"]),
        int(history[-1]["env_steps"]),
        rounded(latched),
        rounded(hypervolume_of(history[best_row(history)])),
        rounded(paper),
    )


def rounded(number: float) -> float:
    return float(f"{number:.6g}")


def reached(rows: Sequence[Row], seeds: int) -> str:
    """Tabulate the shortest limit that reaches each target, with "median (minimum - maximum)"."""
    heads = ["task", "target", "--max-seconds", "hypervolume"]
    heads += ["from Enter to exit (s)", "to the first row (s)", "steps/s"]
    lines = []
    groups: dict[tuple[str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.env, row.max_seconds), []).append(row)
    for goal, targets in TARGETS.items():
        for task, target in targets.items():
            for (_, limit), group in sorted(g for g in groups.items() if g[0][0] == task):
                if len(group) >= seeds and median(r.hypervolume for r in group) >= target:
                    cells = [
                        task,
                        f"{goal}, {target:.3g}",
                        f"{limit:g}",
                        spread([row.hypervolume for row in group], ".3g"),
                        spread([row.command_seconds for row in group], ".1f"),
                        spread([row.first_row_seconds for row in group], ".1f"),
                        f"{median(row.env_steps / row.max_seconds for row in group) / 1e6:.2f} M",
                    ]
                    lines.append(cells)
                    break
    return markdown(heads, lines)


def spread(values: Sequence[float], form: str) -> str:
    return f"{median(values):{form}} ({min(values):{form}} - {max(values):{form}})"


if __name__ == "__main__":
    tyro.cli(main)
