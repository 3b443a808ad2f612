"""Tables and figures of a comparison, from the rows that compare.py has written.

    python benchmarks/compare_report.py --rows rows.csv --figures docs/figures --fronts fronts \\
        --targets hopper=6.0e6

A run counts with the hypervolume of its best checkpoint from noised starts. Tables have the median
over seeds and its bootstrap interval of 95 %. Differences are paired by seed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from compare import KEY
from compare_statistics import best_so_far, interquartile_mean, interval, mean, median
from matplotlib.figure import Figure
from numpy.typing import NDArray
from row_files import Row, markdown, read_rows

from morlax_torch import MorlaxError
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console

FEWEST = 3  # runs whose interval means something
AXES = {"train_seconds": "training (s)", "env_steps": "environment steps"}


class Run(NamedTuple):
    """The rows of a run."""

    training: list[Row]
    best: Row
    noised: Row

    def curve(self, axis: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the column `axis` (E,) of evaluations while training, and hypervolumes (E,)."""
        x, y = ([float(row[name]) for row in self.training] for name in (axis, "hypervolume"))
        return np.array(x), np.array(y)


Runs = dict[str, dict[str, dict[int, Run]]]  # by task, method with its setting, and seed


def main(
    rows: Path,
    ours: str = "MORLAX",
    targets: Sequence[str] = (),
    figures: Path | None = None,
    fronts: Path | None = None,
    objectives: Sequence[int] = (),
) -> None:
    """Print the tables, and draw the figures.

    Args:
        rows: CSV file that compare.py has written.
        ours: The method that others are compared with.
        targets: Hypervolumes to reach, such as hopper=6.0e6.
        figures: Folder to draw in: curves.png, differences.png, times.png for targets,
            overlaid.png for fronts, objectives.png for one robot's tasks with m objectives.
        fronts: Folder of the fronts that compare.py has saved.
        objectives: m of each task, in their order.
    """
    runs = runs_of(read_rows(rows))
    if not runs:
        raise MorlaxError(f"{rows} has no complete run: name a file that compare.py has written.")
    if ours not in _methods(runs):
        names = ", ".join(_methods(runs))
        raise MorlaxError(f"{rows} has no method {ours!r}: use --ours with one of {names}.")
    for evaluation in ("noised", "best"):
        console.print(f"Hypervolume, {evaluation}\n\n{volumes_table(runs, evaluation)}")
    console.print(f"Difference to {ours}, %\n\n{differences_table(runs, ours)}")
    reached = {task: float(x) for task, x in (target.split("=") for target in targets)}
    if reached:
        console.print(times_table(runs, reached))
    if figures:
        drawn = {"curves": curves_figure(runs), "differences": differences_figure(runs, ours)}
        if objectives:
            drawn["objectives"] = objectives_figure(runs, objectives)
        if reached:
            drawn["times"] = times_figure(runs, reached)
        if fronts:
            drawn["overlaid"] = fronts_figure(runs, fronts)
        for name, figure in drawn.items():
            figure.savefig(figures / f"{name}.png", dpi=150)


def runs_of(rows: Sequence[Row]) -> Runs:
    """Sort the rows of complete runs."""
    groups: dict[tuple[str, ...], dict[str, list[Row]]] = {}
    for row in rows:
        group = groups.setdefault(tuple(row[name] for name in KEY), {})
        group.setdefault(row["evaluation"], []).append(row)
    runs: Runs = {}
    for (task, method, setting, seed), group in groups.items():
        if "noised" in group:
            name = ", ".join(part for part in (method, setting) if part)
            run = Run(group["training"], group["best"][0], group["noised"][0])
            runs.setdefault(task, {}).setdefault(name, {})[int(seed)] = run
    return runs


def values(of_method: dict[int, Run], evaluation: str, column: str = "hypervolume") -> list[float]:
    """Return a value of each run, by seed."""
    return [float(getattr(of_method[seed], evaluation)[column]) for seed in sorted(of_method)]


def volumes_table(runs: Runs, evaluation: str) -> str:
    """Return the median hypervolumes, with intervals."""
    lines = []
    for method in _methods(runs):
        cells = []
        for of_task in runs.values():
            scores = values(of_task.get(method, {}), evaluation)
            cells.append(_spread(scores) if scores else "")
        lines.append([method, *cells])
    return markdown(["", *runs], lines)


def differences(runs: Runs, ours: str, method: str) -> dict[str, NDArray[np.float64]]:
    """Return how far `method` is from `ours` by task: paired by seed, in % of our mean."""
    shares = {}
    for task, of_task in runs.items():
        seeds = sorted({*of_task.get(ours, {})} & {*of_task.get(method, {})})
        if seeds:
            mine, theirs = (
                np.array([float(of_task[name][seed].noised["hypervolume"]) for seed in seeds])
                for name in (ours, method)
            )
            shares[task] = 100 * (theirs - mine) / mine.mean()
    return shares


def differences_table(runs: Runs, ours: str) -> str:
    """Return the mean differences to `ours`, with intervals; bold ones exclude zero."""
    lines = []
    for method in _methods(runs):
        shares = differences(runs, ours, method)
        if method == ours or not shares:
            continue
        cells = [_difference([shares[task]]) if task in shares else "" for task in runs]
        groups = [*shares.values()]
        low, high = interval(interquartile_mean, groups)
        middle = f"{interquartile_mean(np.concatenate(groups)):+.1f} ({low:+.1f} to {high:+.1f})"
        lines.append([method, *cells, _difference(groups), middle])
    return markdown(["", *runs, "mean", "interquartile mean"], lines)


def _difference(groups: Sequence[NDArray[np.float64]]) -> str:
    low, high = interval(mean, groups)
    text = f"{np.concatenate(groups).mean():+.1f} ({low:+.1f} to {high:+.1f})"
    return f"**{text}**" if _clear(low, high, groups) else text


def _clear(low: float, high: float, groups: Sequence[NDArray[np.float64]]) -> bool:
    """Return whether an interval excludes zero, and there are enough runs to say so."""
    enough = min(map(len, groups)) > 1 and sum(map(len, groups)) >= FEWEST
    return enough and (low > 0 or high < 0)


def times_table(runs: Runs, targets: dict[str, float]) -> str:
    """Return the median training seconds to a hypervolume, and how many runs reached it."""
    lines = []
    for method in _methods(runs):
        cells = []
        for task, target in targets.items():
            of_method = runs.get(task, {}).get(method, {})
            times = [time_to(run, target) for run in of_method.values()]
            reached = sorted(time for time in times if time is not None)
            cells.append(
                f"{np.median(reached):.1f} s ({len(reached)}/{len(times)})" if reached else ""
            )
        lines.append([method, *cells])
    return markdown(["", *(f"{task}, {target:.3g}" for task, target in targets.items())], lines)


def time_to(run: Run, target: float) -> float | None:
    """Return the training seconds of the first evaluation that reaches a hypervolume."""
    seconds, volumes = run.curve("train_seconds")
    return next((s for s, v in zip(seconds.tolist(), volumes, strict=True) if v >= target), None)


def curves_figure(runs: Runs) -> Figure:
    """Draw the best hypervolume so far over time and steps: median, and lowest to highest run."""
    figure = Figure(figsize=(2.4 * len(runs), 5.2), layout="constrained")
    plots = figure.subplots(len(AXES), len(runs), squeeze=False)
    for row, (axis, label) in zip(plots, AXES.items(), strict=True):
        for axes, (task, of_task) in zip(row, runs.items(), strict=True):
            for number, method in enumerate(_methods(runs)):
                curves = [run.curve(axis) for run in of_task.get(method, {}).values()]
                if not curves:
                    continue
                grid = np.unique(np.concatenate([x for x, _ in curves]))
                heights = np.array([best_so_far(x, y, grid) for x, y in curves])
                color = f"C{number}"
                axes.step(grid, median(heights.T), where="post", color=color, label=method)
                low, high = heights.min(0), heights.max(0)
                axes.fill_between(grid, low, high, step="post", color=color, alpha=0.15, lw=0)
            axes.set(xlabel=label, title=task, ylim=(0, None))
            axes.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel("hypervolume")
    _add_legend(figure)
    return figure


def differences_figure(runs: Runs, ours: str) -> Figure:
    """Draw the differences to `ours`: a dot per run, and the interval of their mean."""
    methods = [method for method in _methods(runs) if method != ours]
    size = (2.4 * len(runs), 1.0 + 0.22 * len(methods))
    figure = Figure(figsize=size, layout="constrained")
    plots = figure.subplots(1, len(runs), squeeze=False, sharey=True)[0]
    for row, method in enumerate(methods):
        shares = differences(runs, ours, method)
        for axes, task in zip(plots, runs, strict=True):
            if task in shares:
                low, high = interval(mean, [shares[task]])
                color = "C1" if _clear(low, high, [shares[task]]) else "0.6"
                axes.plot((low, high), (row, row), color=color, lw=3)
                axes.plot(shares[task], [row] * len(shares[task]), "o", color="C0", ms=3)
    for axes, task in zip(plots, runs, strict=True):
        axes.axvline(0, color="black", lw=0.8)
        axes.set_title(task)
        axes.set_yticks(range(len(methods)), methods)
        axes.spines[["top", "right"]].set_visible(False)
    plots[0].invert_yaxis()
    figure.supxlabel(f"hypervolume, difference to {ours} in %", fontsize="medium")
    return figure


def objectives_figure(runs: Runs, numbers: Sequence[int]) -> Figure:
    """Draw speed, and how well trade-offs are obeyed, over the number of objectives."""
    figure = Figure(figsize=(6.4, 2.6), layout="constrained")
    speed, obeyed = figure.subplots(1, 2)
    for row, method in enumerate(_methods(runs)):
        for number, of_task in zip(numbers, runs.values(), strict=True):
            of_method, color = [*of_task.get(method, {}).values()], f"C{row}"
            last = [run.training[-1] for run in of_method]
            rates = [float(x["env_steps"]) / float(x["train_seconds"]) / 1e6 for x in last]
            speed.plot([number] * len(rates), rates, "o", color=color, ms=4, label=method)
            shares = [float(run.best["obedience"]) for run in of_method]
            obeyed.plot([number] * len(shares), shares, "o", color=color, ms=4)
    speed.set(xlabel="objectives", ylabel="million steps per second")
    speed.set_ylim(0, 1.1 * speed.get_ylim()[1])
    obeyed.set(xlabel="objectives", ylabel="share of trade-offs obeyed", ylim=(0, 1))
    for axes in (speed, obeyed):
        axes.set_xticks(numbers)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = speed.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(named.values(), named, loc="outside upper center", ncols=4, frameon=False)
    return figure


def times_figure(runs: Runs, targets: dict[str, float]) -> Figure:
    """Draw the training seconds of each run to the hypervolume of its task; runs are dots."""
    figure = Figure(figsize=(2.4 * len(targets), 2.2), layout="constrained")
    plots = figure.subplots(1, len(targets), squeeze=False, sharey=True)[0]
    methods = _methods(runs)
    for axes, (task, target) in zip(plots, targets.items(), strict=True):
        for row, method in enumerate(methods):
            times = [time_to(run, target) for run in runs[task].get(method, {}).values()]
            reached = [time for time in times if time is not None]
            axes.plot(reached, [row] * len(reached), "o", color=f"C{row}", alpha=0.6, clip_on=False)
        axes.set(xlabel="training (s)", title=f"{task}, {target:.3g}", xlim=(0, None))
        axes.set_yticks(range(len(methods)), methods)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", alpha=0.3)
    plots[0].invert_yaxis()
    return figure


def fronts_figure(runs: Runs, folder: Path) -> Figure:
    """Draw the non-dominated returns of each method's median run."""
    figure = Figure(figsize=(2.4 * len(runs), 2.8), layout="constrained")
    plots = figure.subplots(1, len(runs), squeeze=False)[0]
    for axes, (task, of_task) in zip(plots, runs.items(), strict=True):
        for number, method in enumerate(_methods(runs)):
            of_method = of_task.get(method, {})
            ranked = sorted(of_method, key=lambda seed: float(of_method[seed].best["hypervolume"]))
            if not ranked:
                continue
            seed = ranked[len(ranked) // 2]
            with np.load(folder / f"{task}, {method}, {seed}.npz") as front:
                points, names = front["returns"][front["non_dominated"]], front["objectives"]
            axes.plot(*points[:, :2].T, ".", color=f"C{number}", ms=3, label=method)
        axes.set(xlabel=names[0], ylabel=names[1], title=task)
        axes.spines[["top", "right"]].set_visible(False)
    _add_legend(figure)
    return figure


def _add_legend(figure: Figure) -> None:
    handles, labels = figure.axes[0].get_legend_handles_labels()
    options = {"loc": "outside lower center", "ncols": 4, "frameon": False}
    figure.legend(handles, labels, markerscale=3, **options)


def _methods(runs: Runs) -> list[str]:
    return list(dict.fromkeys(method for of_task in runs.values() for method in of_task))


def _spread(scores: Sequence[float]) -> str:
    """Return the median and its interval, all with the power of ten of the median."""
    low, high = interval(median, [scores])
    power = int(np.floor(np.log10(max(np.median(scores), 1e-300)) / 3)) * 3
    middle, low, high = (x / 10.0**power for x in (np.median(scores), low, high))
    return f"{middle:#.3g}e{power} ({low:#.3g} to {high:#.3g})"


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
