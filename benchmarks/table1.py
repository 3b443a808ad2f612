"""Reproduce the paper's Table I: hypervolume over training time, and time to the targets.

    python benchmarks/table1.py --seconds 60 --output table1

Two protocols are compared: the package's (a fixed set of 512 trade-offs, episodes that stop
counting at their first end) and the paper's (1,024 Dirichlet trade-offs, only failed steps masked,
the reward at the reset added). Training time excludes evaluations. The `train` command then runs
again for the training time that reached HYPER-MORL's maximum, to see how long a user waits in all.
Writes OUTPUT.csv, one row per evaluation, OUTPUT.md, the table, and OUTPUT.png, the curves. To
merge rows measured on several GPUs into one table:

    python benchmarks/table1.py --env --given first.csv second.csv --output table1
"""

import csv
import itertools
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from training_curve import TARGETS, Point, command_seconds, reached, training_curve

from morlax_torch import config_for
from morlax_torch.config import Config
from morlax_torch.envs import resolve_device
from morlax_torch.terminal.cli import console

PAPER_SECONDS = {  # to HYPER-MORL's maximum: (MORLAX on an RTX A4000, HYPER-MORL on a CPU)
    "cheetah": (144.0, 4955.0),
    "walker": (307.1, 8075.8),
    "ant": (533.7, 13338.6),
    "hopper": (53.2, 12728.2),
    "humanoid": (92.4, 25950.0),
}
PROTOCOLS = ("latched", "paper")
COLUMNS = (
    *("env", "seed", "train_seconds", "total_seconds", "env_steps"),
    *("hypervolume", "hypervolume_paper_protocol", "command_seconds"),
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
    """Train, evaluate and write the table.

    Args:
        env: Tasks to train.
        seconds: Training time per run, in seconds.
        seeds: Random seeds, one run of each task per seed.
        every: Training seconds between evaluations.
        given: CSV files with rows from earlier runs.
        device: cuda or cpu (None: CUDA if available).
        output: Path of the output files, without a suffix.
    """
    if not (env or given):
        raise SystemExit("nothing to do: pass a task with --env, or CSV files with --given.")
    runs = read(given)
    if env:
        place = resolve_device(device)
    with Path(f"{output}.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(COLUMNS)
        rows.writerows(row(*key, p) for key, points in runs.items() for p in points)
        for task, seed in itertools.product(env, seeds):
            config = config_for(task, seed=seed, device=str(place))
            points = training_curve(config, seconds, every, PROTOCOLS)
            runs[task, seed] = [timed(config, p, points) for p in points]
            rows.writerows(row(task, seed, p) for p in runs[task, seed])
            file.flush()
            console.print(f"{task}, seed {seed}: {runs[task, seed][-1]}")
    curves_of = {task: [] for task in TARGETS if any(task == name for name, _ in runs)}
    for (task, _), points in sorted(runs.items()):
        curves_of[task].append(points)
    table = markdown(curves_of)
    console.print(table)
    Path(f"{output}.md").write_text(table)
    curves(curves_of).savefig(f"{output}.png", dpi=130)


def timed(config: Config, point: Point, points: list[Point]) -> Point:
    """Time the command if `point` is the first that reaches HYPER-MORL's maximum."""
    if point is not reached(points, TARGETS[config.env][0]):
        return point
    return point._replace(command_seconds=command_seconds(config, point.train_seconds))


def row(task: str, seed: int, point: Point) -> list[str | int | float]:
    """Return the CSV row of one evaluation; the last cell is empty if no command was timed."""
    volumes = [point.hypervolume[name] for name in PROTOCOLS]
    command = point.command_seconds
    return [task, seed, *point[:3], *volumes, "" if command is None else command]


def read(files: tuple[Path, ...]) -> dict[tuple[str, int], list[Point]]:
    """Read runs from CSV files, by task and seed."""
    runs: dict[tuple[str, int], list[Point]] = {}
    for path in files:
        with path.open(newline="") as file:
            lines = csv.reader(file)
            next(lines)
            for task, seed, trained, total, steps, *found in lines:
                *volumes, command = (float(cell) if cell else None for cell in found)
                by_protocol = dict(zip(PROTOCOLS, volumes, strict=True))
                point = Point(float(trained), float(total), int(steps), by_protocol, command)
                runs.setdefault((task, int(seed)), []).append(point)
    return runs


def markdown(runs: dict[str, list[list[Point]]]) -> str:
    """Format the table, with "median (minimum - maximum)" over the seeds."""
    lines = [
        "| task | steps/s | to HYPER-MORL's maximum | from the command | "
        "MORLAX, HYPER-MORL in the paper | to the paper's MORLAX maximum | best hypervolume | "
        "by the paper's protocol |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for task, seeds in runs.items():
        low, high = TARGETS[task]
        speed = median(p[-1].env_steps / p[-1].train_seconds for p in seeds)
        morlax, hyper_morl = PAPER_SECONDS[task]
        best = {
            name: [max(p.hypervolume[name] for p in points) for points in seeds]
            for name in PROTOCOLS
        }
        first, second = ([reached(points, goal) for points in seeds] for goal in (low, high))
        cells = [
            task,
            f"{speed / 1e6:.2f} M",
            f"{low:.3g}: {spread([p and p.train_seconds for p in first])} s",
            f"{spread([p and p.command_seconds for p in first])} s",
            f"{morlax:.0f} s, {hyper_morl:.0f} s",
            f"{high:.3g}: {spread([p and p.train_seconds for p in second])} s",
            spread(best["latched"], ".3e"),
            spread(best["paper"], ".3e"),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def spread(values: list[float | None], form: str = ".1f") -> str:
    """Format median and range; a run that misses the target counts as infinite time."""
    known = sorted(float("inf") if value is None else value for value in values)
    words = ["never" if value == float("inf") else f"{value:{form}}" for value in known]
    middle = median(known)
    middle_word = "never" if middle == float("inf") else f"{middle:{form}}"
    return f"{middle_word} ({words[0]} - {words[-1]})" if len(known) > 1 else words[0]


def curves(runs: dict[str, list[list[Point]]]) -> Figure:
    """Plot hypervolume over training seconds, one line per seed, with the targets dashed."""
    columns = min(len(runs), 3)
    rows = -(-len(runs) // columns)
    figure = Figure(figsize=(5.0 * columns, 3.4 * rows), layout="constrained")
    for index, (task, seeds) in enumerate(runs.items()):
        axes = figure.add_subplot(rows, columns, index + 1)
        for points in seeds:
            seconds = [p.train_seconds for p in points]
            axes.plot(seconds, [p.hypervolume["latched"] for p in points], color="C0", alpha=0.7)
        for target in TARGETS[task]:
            axes.axhline(target, color="0.4", linestyle="--", linewidth=0.8)
        _name_targets(axes, TARGETS[task])
        axes.set_title(task)
        axes.set_xlabel("training time (s)")
        axes.set_ylabel("hypervolume")
        axes.grid(alpha=0.3)
    return figure


def _name_targets(axes: Axes, targets: Sequence[float]) -> None:
    """Write the names of the targets to the right of the axes, apart from each other."""
    low, high = axes.get_ylim()
    first, second = sorted(targets)
    apart = max(0.0, 0.06 - (second - first) / (high - low)) * (high - low) / 2
    for height, name in ((first - apart, "HYPER-MORL"), (second + apart, "MORLAX, paper")):
        right = {"xycoords": ("axes fraction", "data"), "ha": "left", "va": "center"}
        axes.annotate(name, (1.015, height), fontsize="small", color="0.3", **right)


if __name__ == "__main__":
    tyro.cli(main)
