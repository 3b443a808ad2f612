"""Write the tables of README.md and of two pages of docs from the rows in benchmarks/results.

python benchmarks/tables.py          # rewrite them in place
python benchmarks/tables.py --check  # name the tables that differ from their rows

On a page, a table stands below a comment with its name, such as <!-- table: pgmorl -->.
"""

import argparse
import math
import re
import sys
from collections.abc import Iterable, Sequence
from decimal import ROUND_HALF_UP, Decimal
from itertools import groupby
from pathlib import Path
from statistics import median

import compare_report
from row_files import Row, markdown, read_rows

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / page for page in ("docs/results.md", "docs/mjlab.md", "README.md")]
RESULTS = ROOT / "benchmarks" / "results"
MARK = re.compile(r"^(<!-- table: (\w+) -->\n\n)((?:\|.*\n)+)", re.MULTILINE)

# MO-Playground (arXiv 2603.09237), Table I: the highest hypervolumes of HYPER-MORL, which are our
# targets, and how long HYPER-MORL and MORLAX took to reach them
TARGETS = {
    "cheetah": "5.58e6",
    "walker": "5.28e6",
    "ant": "2.70e7",
    "hopper": "6.0e6",
    "humanoid": "0.74e6",
}
PAPER = (
    ("HYPER-MORL", "a CPU", "4,955 s", "8,076 s", "13,339 s", "12,728 s", "25,950 s"),
    ("MORLAX in JAX", "an RTX A4000", "144 s", "307 s", "534 s", "53 s", "92 s"),
)
# PG-MORL's tasks, with a power of ten: HYPER-MORL (arXiv 2406.18924, means of nine seeds), PD-MORL
# (ICLR 2023) and COLA (NeurIPS 2025, five runs with 201 preferences; its ant after 3 M steps)
PGMORL = {
    ("hopper", 7): ("2.05", "1.88", "2.11"),
    ("hopper3", 10): ("3.58", "", "3.41"),
    ("swimmer", 4): ("2.88", "3.21", ""),
    ("halfcheetah", 6): ("5.53", "5.89", ""),
    ("ant", 6): ("7.49", "7.48", "11.33"),
    ("humanoid", 7): ("4.32", "", ""),
    ("walker2d", 6): ("5.37", "5.41", "4.87"),
}
# C-MORL (ICLR 2025) and D3PO, as the tables of D3PO (arXiv 2602.07764) print both
CMORL = {
    ("hopper-2obj", 5): ("1.37", "1.30"),
    ("hopper", 7): ("2.19", "2.12"),
    ("ant-2obj", 5): ("1.31", "1.91"),
    ("ant", 7): ("2.61", "2.68"),
    ("humanoid", 5): ("3.43", "3.76"),
}


def read(file: str, **columns: str) -> list[Row]:
    """Return the rows of a CSV file whose columns have these values."""
    return [row for row in read_rows(RESULTS / file) if columns.items() <= row.items()]


def values(rows: Iterable[Row], column: str = "hypervolume") -> list[float]:
    return [float(row[column]) for row in rows]


def by_seed(rows: Iterable[Row]) -> list[list[float]]:
    """Return the hypervolumes of each run, in the order of seeds and evaluations."""
    runs: dict[int, list[float]] = {}
    for row in rows:
        runs.setdefault(int(row["seed"]), []).append(float(row["hypervolume"]))
    return [runs[seed] for seed in sorted(runs)]


def number(value: float, digits: int = 0, power: int = 0) -> str:
    """Return value / 10**power with `digits` after the point; ties of decimals round up."""
    scaled = Decimal(str(value)).scaleb(-power)
    return str(scaled.quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP))


def listed(numbers: Sequence[float], digits: int, power: int = 0, above: float = math.inf) -> str:
    """Return numbers in units of 10**power, those above a limit (in the same units) in bold."""
    parts = []
    for is_above, group in groupby(numbers, lambda value: value > above * 10**power):
        text = ", ".join(number(value, digits, power) for value in group)
        parts.append(f"**{text}**" if is_above else text)
    return ", ".join(parts)


def in_millions(methods: dict[str, list[list[float]]], digits: Sequence[int]) -> list[list[str]]:
    """Return a line of medians per method, the highest of each column in bold.

    Args:
        methods: for each column, the hypervolumes of a method's runs; without any, a cell is empty.
        digits: digits after the point, for each column.
    """
    lines = [[method] for method in methods]
    for runs, places in zip(zip(*methods.values(), strict=True), digits, strict=True):
        best = max(median(volumes) for volumes in runs if volumes)
        for line, volumes in zip(lines, runs, strict=True):
            text = number(median(volumes), places, 6) if volumes else ""
            line.append(f"**{text}**" if volumes and median(volumes) == best else text)
    return lines


def reported(task: str) -> list[Row]:
    """Return the commands of the seeds that chose no limit."""
    return [row for row in read("table1-h200.csv", env=task) if int(row["seed"]) >= 200]


def targets() -> str:
    lines = []
    for task, target in TARGETS.items():
        rows, power = reported(task), int(target[-1])
        limit, volumes = rows[0]["max_seconds"], values(rows)
        spread = [number(x, 2, power) for x in (median(volumes), min(volumes), max(volumes))]
        hypervolume = f"{spread[0]}e{power} ({spread[1]} - {spread[2]})"
        command = number(median(values(rows, "command_seconds")), 1)
        speed = number(median(values(rows, "env_steps")) / float(limit), 2, 6)
        lines.append([task, target, limit, hypervolume, f"{command} s", f"{speed} M"])
    head = ["task", "target", "`--max-seconds`", "hypervolume: median (range)", "whole command"]
    return markdown([*head, "steps/s"], lines)


def original(task: str, column: str) -> str:
    """Return the seconds after which the authors' program reaches the target."""
    rows = read("original-h200.csv", task=task)
    reached = [row for row in rows if float(row["hypervolume"]) >= float(TARGETS[task])]
    if not reached:
        return f"not in {number(float(rows[-1][column]))} s"
    return f"{number(float(reached[0][column]))} s"


def readme() -> str:
    limits, commands = [], []
    for task in TARGETS:
        rows = reported(task)
        limits.append(f"{rows[0]['max_seconds']} s")
        commands.append(f"{number(median(values(rows, 'command_seconds')), 1)} s")
    times = {
        "MORLAX in JAX, the authors' program, training": "wall_train_seconds",
        "the same, whole, with compiling": "wall_total_seconds",
    }
    lines = [
        *PAPER,
        *([name, "one H200", *(original(task, times[name]) for task in TARGETS)] for name in times),
        ["morlax_torch, training (`--max-seconds`)", "one H200", *limits],
        ["morlax_torch, whole command, kernels compiled before", "one H200", *commands],
    ]
    return markdown(["", "hardware", *TARGETS], lines)


def compared() -> compare_report.Runs:
    return compare_report.runs_of(read("comparison-h100.csv"))


def volumes() -> str:
    return compare_report.volumes_table(compared(), "noised")


def ahead() -> str:
    return compare_report.differences_table(compared(), "MORLAX")


def times() -> str:
    targets = {task: float(target) for task, target in TARGETS.items()}
    return compare_report.times_table(compared(), targets)


def few_steps() -> str:
    tasks = ("cheetah", "hopper", "mo-gymnasium/hopper-2obj", "mo-gymnasium/halfcheetah")
    steps = {
        "hyper-sac, 100,000 steps": "hyper-sac, --max-env-steps 100000",
        "CAPQL, 100,000 steps": "capql of morl-baselines",
        "MORLAX, 100,000 steps": "morlax, --max-env-steps 100000",
    }
    seconds = {
        "hyper-sac, 120 s": "hyper-sac",
        "MORLAX, 120 s": "morlax",
    }
    lines = []
    for file, runs in (("off-policy.csv", steps), ("off-policy-120s.csv", seconds)):
        methods: dict[str, list[list[float]]] = {name: [] for name in runs}
        for name, algorithm in runs.items():
            for task in tasks:
                rows = read(f"comparison/{file}", task=task, algorithm=algorithm)
                methods[name].append([max(run) for run in by_seed(rows)])
        lines += in_millions(methods, [2] * len(tasks))
    return markdown(["", *tasks], lines)


def pgmorl() -> str:
    lines = []
    for (task, power), published in PGMORL.items():
        with_cells = task in ("hopper", "hopper3", "swimmer")
        options = "--sampling.cells" if with_cells else ""
        rows = read("pgmorl-h200.csv", task=f"pgmorl/{task}", options=options)
        volumes = [run[-1] for run in by_seed(rows)]
        if not with_cells:  # seed 0 is the search's last run, whose options became the config
            run = read("search-h200.csv", env=f"pgmorl/{task}")[-1]
            volumes.insert(0, float(run["curve_seconds:hypervolume"].rpartition(":")[2]))
        ours = listed(volumes, 2, power, max(float(text) for text in published if text))
        steps = number(float(rows[-1]["env_steps"]), 0, 6)
        lines.append([f"{task}, 1e{power}", *published, ours, f"{steps} M"])
    return markdown(["", "HYPER-MORL", "PD-MORL", "COLA", "MORLAX", "steps"], lines)


def cmorl() -> str:
    lines = []
    for (task, power), published in CMORL.items():
        ours, sac = "morlax", "hyper-sac"
        if task == "humanoid":
            ours += ", --network.symmetric --network.asymmetry 0.3"
            sac += ", --network.no-symmetric --network.asymmetry 0"
        cells = []
        for algorithm, evaluated in ((ours, "in training"), (sac, "best.pt again")):
            columns = {"algorithm": algorithm, "evaluated": evaluated}
            runs = by_seed(read("published-h200.csv", task=f"mo-gymnasium/{task}", **columns))
            cells.append(listed([run[-1] for run in runs], 2, power, max(map(float, published))))
        lines.append([f"{task}, 1e{power}", *published, *cells])
    head = ["", "C-MORL", "D3PO", "MORLAX, seeds 0 to 4", "hyper-sac, 1.5 M steps"]
    return markdown(head, lines)


def mjlab() -> str:
    lines = []
    for robot, rows in (
        ("Go1", read("mjlab-go1-real-h200.csv")),
        ("G1", read("mjlab-g1-real-h200.csv")),
    ):
        for name, run, policy in (
            (f"{robot}, {{}}, tracks best", "real", "best tracking"),
            (f"{robot}, {{}}, least power", "real", "least power"),
            (f"mjlab's {robot}, {{}}", "mjlab's own training", ""),
        ):
            chosen = [row for row in rows if row["run"].startswith(run) and row["policy"] == policy]
            if chosen:
                seeds = ", ".join(row["run"].rsplit(" ", 1)[1] for row in chosen)
                seeds = f"seed{'s' if len(chosen) > 1 else ''} {seeds}"
                lines.append([name.format(seeds), *walk(chosen)])
    head = ["", "error of the velocity, m/s", "commanded speed, m/s", "share of it", "power, W"]
    return markdown(head, lines)


def walk(rows: Sequence[Row]) -> list[str]:
    """Return cells of how policies walk, with one number per row in each."""
    speed, share = values(rows, "speed (m/s)"), values(rows, "speed (share of the commanded)")
    commanded = [one / part for one, part in zip(speed, share, strict=True)]
    error, power = values(rows, "velocity error (m/s)"), values(rows, "power (W)")
    return [listed(error, 3), listed(commanded, 2), listed(share, 2), listed(power, 1)]


def tour() -> str:
    columns = {
        "survival (s)": ("survival, s", 1),
        "completed (%)": ("completed, %", 0),
        "position error (cm)": ("position, cm", 0),
        "yaw error (deg)": ("yaw, degrees", 0),
        "walk energy (kJ)": ("energy, kJ", 1),
        "vibration (1e6 rad/s^2)": ("vibration", 2),
    }
    lines = []
    for row in read("mjlab-tour-cpu.csv", runs="256"):
        seed = row["run"].partition(",")[0]
        weights = ", ".join(row[name] for name in ("survival", "tracking", "energy", "vibration"))
        cells = (number(float(row[name]), digits) for name, (_, digits) in columns.items())
        lines.append([f"{seed}: {weights}", *cells])
    return markdown(["trade-off", *(name for name, _ in columns.values())], lines)


def throughput() -> str:
    tasks = ("cheetah", "walker", "hopper", "ant", "humanoid", "bruce")
    worlds = (4096, 4096, 8192, 8192, 8192, 4096)  # of the configs
    head, speeds, shares = ["H200, worlds of the config"], ["environment steps/s"], []
    for task, count in zip(tasks, worlds, strict=True):
        (row,) = read("throughput-h200.csv", task=task, worlds=str(count))
        speeds.append(f"{number(float(row['training_Msteps/s']), 2)} M")
        shares.append(f"{number(float(row['training/physics']), 0, -2)} %")
        head.append(f"{task}, {count:,}")
    return markdown(head, [speeds, ["share of raw physics", *shares]])


def gpus() -> str:
    tasks = ("humanoid", "hopper", "walker", "ant")
    lines = [["two"], ["four"]]
    for task in tasks:
        one, two, four = (
            median(values(read("scaling-h200.csv", task=task, gpus=count), "steps_per_second"))
            for count in ("1", "2", "4")
        )
        lines[0].append(number(two / one, 2))
        lines[1].append(number(four / one, 2))
    return markdown(["", *tasks], lines)


FUNCTIONS = (
    *(readme, targets, volumes, ahead, times, few_steps),
    *(pgmorl, cmorl, mjlab, tour, throughput, gpus),
)
TABLES = {function.__name__: function for function in FUNCTIONS}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="only name the tables that differ")
    check = parser.parse_args(arguments).check
    different = []
    for page in PAGES:
        text = page.read_text()
        different += [name for _, name, table in MARK.findall(text) if table != TABLES[name]()]
        if not check:
            page.write_text(MARK.sub(lambda mark: mark[1] + TABLES[mark[2]](), text))
    for name in different:
        print(f"{name}: {'differs from' if check else 'rewritten from'} its rows")
    if check and different:
        sys.exit(1)


if __name__ == "__main__":
    main()
