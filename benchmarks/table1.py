"""The paper's Table I, measured here: hypervolume against seconds, and time to the targets.

    python benchmarks/table1.py --seconds 60 --output table1

Beside our own protocol (a fixed set of 512 trade-offs, episodes latched at their first end) stands
the paper's (1,024 Dirichlet trade-offs, failures masked step by step, the reset's reward added).
Evaluations are off the training clock. Writes OUTPUT.csv, a row for each evaluation, OUTPUT.md, the
table, and OUTPUT.png, the curves. Rows of several GPUs come into one table by

    python benchmarks/table1.py --env --given first.csv second.csv --output table1
"""

import csv
import itertools
from pathlib import Path
from statistics import median

import tyro
from matplotlib.figure import Figure
from training_curve import TARGETS, Point, reached, training_curve

from morlax_torch import config_for
from morlax_torch.envs import resolve_device
from morlax_torch.terminal.cli import console

PAPER_SECONDS = {  # (MORLAX on an RTX A4000, HYPER-MORL on a CPU) to HYPER-MORL's maximum
    "cheetah": (144.0, 4955.0),
    "walker": (307.1, 8075.8),
    "ant": (533.7, 13338.6),
    "hopper": (53.2, 12728.2),
    "humanoid": (92.4, 25950.0),
}
PROTOCOLS = ("latched", "paper")
COLUMNS = (
    *("env", "seed", "train_seconds", "total_seconds", "env_steps"),
    *("hypervolume", "hypervolume_paper_protocol"),
)


def main(
    env: tuple[str, ...] = tuple(TARGETS),
    seconds: float = 60.0,
    seeds: tuple[int, ...] = (0, 1, 2),
    every: float = 1.0,
    given: tuple[Path, ...] = (),
    device: str | None = None,
    output: Path = Path("table1"),
) -> None:
    """Measure.

    Args:
        env: Which tasks.
        seconds: Training time of each run.
        seeds: A run of each task for each.
        every: Training seconds between evaluations.
        given: CSV files of rows that were measured before.
        device: cuda or cpu (None: CUDA where there is one).
        output: Name of the files, without its ending.
    """
    if not (env or given):
        raise SystemExit("there is nothing to show: name a task with --env, or rows with --given")
    runs = read(given)
    if env:
        place = resolve_device(device)
    with output.with_suffix(".csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        rows.writerows(row(*key, p) for key, points in runs.items() for p in points)
        for task, seed in itertools.product(env, seeds):
            config = config_for(task, seed=seed, device=str(place))
            runs[task, seed] = training_curve(config, seconds, every, PROTOCOLS)
            rows.writerows(row(task, seed, p) for p in runs[task, seed])
            file.flush()
            console.print(f"{task}, seed {seed}: {runs[task, seed][-1]}")
    curves_of = {task: [] for task in TARGETS if any(task == name for name, _ in runs)}
    for (task, _), points in sorted(runs.items()):
        curves_of[task].append(points)
    table = markdown(curves_of)
    console.print(table, markup=False)
    output.with_suffix(".md").write_text(table)
    curves(curves_of).savefig(output.with_suffix(".png"), dpi=130)


def row(task: str, seed: int, point: Point) -> list[str | int | float]:
    """What stands in the CSV."""
    return [task, seed, *point[:3], *(point.hypervolume[name] for name in PROTOCOLS)]


def read(files: tuple[Path, ...]) -> dict[tuple[str, int], list[Point]]:
    """The runs in CSV files, by task and seed."""
    runs: dict[tuple[str, int], list[Point]] = {}
    for path in files:
        with path.open(newline="") as file:
            lines = csv.reader(file)
            next(lines)  # the names of the columns
            for task, seed, trained, total, steps, *found in lines:
                volumes = dict(zip(PROTOCOLS, map(float, found), strict=True))
                point = Point(float(trained), float(total), int(steps), volumes)
                runs.setdefault((task, int(seed)), []).append(point)
    return runs


def markdown(runs: dict[str, list[list[Point]]]) -> str:
    """The table; "median (least - most)" over the seeds."""
    lines = [
        "| task | steps/s | to HYPER-MORL's maximum | MORLAX, HYPER-MORL in the paper | "
        "to the paper's MORLAX maximum | best hypervolume | by the paper's protocol |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for task, seeds in runs.items():
        low, high = TARGETS[task]
        speed = median(p[-1].env_steps / p[-1].train_seconds for p in seeds)
        mine, theirs = PAPER_SECONDS[task]
        best = {
            name: [max(p.hypervolume[name] for p in points) for points in seeds]
            for name in PROTOCOLS
        }
        cells = [
            task,
            f"{speed / 1e6:.2f} M",
            f"{low:.3g}: {spread([reached(p, low) for p in seeds])} s",
            f"{mine:.0f} s, {theirs:.0f} s",
            f"{high:.3g}: {spread([reached(p, high) for p in seeds])} s",
            spread(best["latched"], ".3e"),
            spread(best["paper"], ".3e"),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def spread(values: list[float | None], form: str = ".1f") -> str:
    """Median and range; runs that never got there count as infinitely late."""
    known = sorted(float("inf") if value is None else value for value in values)
    words = ["never" if value == float("inf") else f"{value:{form}}" for value in known]
    middle = median(known)
    middle_word = "never" if middle == float("inf") else f"{middle:{form}}"
    return f"{middle_word} ({words[0]} - {words[-1]})" if len(known) > 1 else words[0]


def curves(runs: dict[str, list[list[Point]]]) -> Figure:
    """Hypervolume against training seconds, a line for each seed, the targets dashed."""
    columns = min(len(runs), 3)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained")
    for index, (task, seeds) in enumerate(runs.items()):
        axes = figure.add_subplot(rows, columns, index + 1)
        for points in seeds:
            seconds = [p.train_seconds for p in points]
            axes.plot(seconds, [p.hypervolume["latched"] for p in points], color="C0", alpha=0.7)
        for target, name in zip(TARGETS[task], ("HYPER-MORL", "MORLAX, paper"), strict=True):
            axes.axhline(target, color="0.4", linestyle="--", linewidth=0.8)
            left = {"xycoords": ("axes fraction", "data"), "ha": "left", "va": "bottom"}
            axes.annotate(name, (0.01, target), fontsize=7, color="0.3", **left)
        axes.set_title(task)
        axes.set_xlabel("training time (s)")
        axes.set_ylabel("hypervolume")
        axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    tyro.cli(main)
