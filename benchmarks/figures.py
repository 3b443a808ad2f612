"""Draw figures of docs/results.md from the rows in benchmarks/results.

python benchmarks/figures.py
"""

import argparse
import csv
from pathlib import Path
from statistics import median

from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
TASKS = ("cheetah", "walker", "hopper", "ant", "humanoid")
METHODS = {
    "MORLAX": "#1f6fb4",
    "HYPER-MORL": "#e07b28",
    "AMOR": "#2a9d5c",
    "AMOR, as many parameters": "#8bc79f",
    "PG-MORL": "#a35fb0",
    "NSGA-II": "#8a8a8a",
    "independent policies": "#222222",
}


def last_hypervolumes(path: Path) -> dict[tuple[str, str], list[float]]:
    """Return the hypervolumes of `best.pt`, evaluated again, by task and method."""
    runs: dict[tuple[str, str], list[float]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if row["fresh"] == "1":
                volumes = runs.setdefault((row["task"], row["method"]), [])
                volumes.append(float(row["hypervolume"]))
    return runs


def algorithms_figure(path: Path) -> Figure:
    """Draw each seed's hypervolume as a share of MORLAX's median, one column per robot."""
    runs = last_hypervolumes(path)
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.axhline(1, color="#bbbbbb", linewidth=1)
    for column, task in enumerate(TASKS):
        reference = median(runs[task, "MORLAX"])
        for number, (method, color) in enumerate(METHODS.items()):
            shares = [volume / reference for volume in runs[task, method]]
            x = column + (number - 3) * 0.11
            label = method if column == 0 else None
            axes.scatter([x] * len(shares), shares, s=14, color=color, alpha=0.8, label=label)
            axes.plot([x - 0.04, x + 0.04], [median(shares)] * 2, color=color, linewidth=2)
    axes.set_xticks(range(len(TASKS)), TASKS)
    axes.set_ylim(0, 1.3)
    axes.set_ylabel("hypervolume / MORLAX's median")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows = ROOT / "benchmarks" / "results" / "comparison" / "rows.csv"
    algorithms_figure(rows).savefig(ROOT / "docs" / "figures" / "algorithms.png", dpi=150)
