"""The report of a comparison: tables and figures, from rows.csv alone."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from compare_statistics import (
    CONFIDENCE,
    QUARTILES,
    band,
    interquartile_mean,
    interval,
    normalizer,
    profile,
    resampled,
)
from matplotlib.figure import Figure

from morlax_torch.envs.naming import title
from morlax_torch.evaluation.figures import SCALES, save
from morlax_torch.evaluation.style import blank, distinct, lattice, legend_outside
from morlax_torch.host.files import read, write_file
from morlax_torch.reports.page import words

INDICATORS = ("igd_plus", "expected_utility", "sparsity", "obedience")  # of rows.csv, in tables
SHARE = "% of the reference"
SPEED = "env steps/s"
THRESHOLDS = 101  # of a performance profile
NOTE = """\
Each cell is the median (lower quartile - upper quartile) over runs. A run counts with its best
checkpoint, loaded and evaluated once more, on other episodes than those that it was chosen by; a
crashed run with the best one before the crash, and without any its hypervolume is 0. The speed is
that of training, without evaluations. The reference's front is the union of the fronts of all its
runs, and IGD+ is the distance from it, with every objective divided by the reference's range.
Scores are hypervolumes divided by the reference's, or by the best median over runs in a task
without a reference. They leave out the reference, and tasks that not all methods have trained on.
"""

Scores = dict[str, dict[str, np.ndarray]]  # method -> task -> (n,) one score per run


class Trained(NamedTuple):
    """A run, as rows.csv holds it, with E evaluations."""

    task: str
    method: str
    reference: bool  # whether the method is the reference
    seed: int
    env_steps: np.ndarray  # (E,)
    train_seconds: np.ndarray  # (E,)
    hypervolume: np.ndarray  # (E,)
    best: float  # hypervolume of the chosen checkpoint, 0 without one
    indicators: dict[str, float]  # of the chosen checkpoint, by name
    reference_hypervolume: float | None  # of the task; None: it has no reference
    error: str  # empty if the run did not crash

    def measures(self) -> dict[str, float]:
        """Return the known columns of the run's table by name."""
        found = {"hypervolume": self.best}
        if self.reference_hypervolume is not None:
            found[SHARE] = 100 * self.best / self.reference_hypervolume
        found |= {words(name): value for name, value in self.indicators.items()}
        if len(self.train_seconds) and self.train_seconds[-1] > 0:
            found[SPEED] = self.env_steps[-1] / self.train_seconds[-1]
        return found


def report(output: Path) -> str:
    """Write results.md and the figures of OUTPUT/rows.csv, and return the tables.

    Raises:
        MorlaxError: there is no such file, or a file cannot be written.
    """
    runs = read_runs(output / "rows.csv")
    rated = scores(runs)
    text = results(runs, rated)
    write_file(output / "results.md", text)
    save(hypervolume_figure(runs), output / "hypervolume", ("png",))
    if rated:
        save(profile_figure(rated), output / "profile", ("png",))
        save(mean_figure(rated), output / "interquartile_mean", ("png",))
    return text


def read_runs(path: Path) -> list[Trained]:
    """Read the runs of a rows.csv.

    Raises:
        MorlaxError: there is no such file.
    """
    text = read(path, "table of evaluations").decode()
    found: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in csv.DictReader(io.StringIO(text, newline="")):
        names = "task", "method", "reference", "seed", "reference_hypervolume"
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    return [_trained(*key, rows) for key, rows in found.items()]


def _trained(
    task: str, method: str, reference: str, seed: str, volume: str, rows: list[dict[str, str]]
) -> Trained:
    measured = [row for row in rows if row["hypervolume"]]
    fresh = [row for row in measured if row.get("fresh") == "1"]
    seen = [row for row in measured if row not in fresh]
    curves = [
        np.array([float(row[name]) for row in seen])
        for name in ("env_steps", "train_seconds", "hypervolume")
    ]
    # tables of up to version 0.3 have no fresh evaluations
    chosen = fresh or sorted(seen, key=lambda row: float(row["hypervolume"]))[-1:]
    best = chosen[0] if chosen else {}
    return Trained(
        task,
        method,
        reference == "1",
        int(seed),
        *curves,
        float(best.get("hypervolume", 0.0)),
        {name: float(best[name]) for name in INDICATORS if best.get(name)},
        float(volume) if volume else None,
        rows[-1]["error"],
    )


def scores(runs: Iterable[Trained]) -> Scores:
    """Return the normalized hypervolumes of every method but the reference.

    Only tasks that all of them have trained on are in it.
    """
    rated = [run for run in runs if not run.reference]
    methods = dict.fromkeys(run.method for run in rated)
    found: Scores = {}
    for task in dict.fromkeys(run.task for run in rated):
        own = [run for run in rated if run.task == task]
        best = {name: np.array([r.best for r in own if r.method == name]) for name in methods}
        if all(len(values) for values in best.values()):
            scale = normalizer(best.values(), own[0].reference_hypervolume)
            for name, values in best.items() if scale > 0 else ():
                found.setdefault(name, {})[task] = values / scale
    return found


def results(runs: Sequence[Trained], rated: Scores) -> str:
    """Return all tables as Markdown."""
    parts = ["# Results\n", NOTE]
    if rated:
        parts += ["## All tasks\n", _scores_table(rated)]
    for task in dict.fromkeys(run.task for run in runs):
        own = [run for run in runs if run.task == task]
        parts += [f"## {title(task)}\n", _task_table(own)]
        crashes = [
            f"- {run.method}, seed {run.seed}: {' '.join(run.error.split())}\n"
            for run in own
            if run.error
        ]
        if crashes:
            parts += ["Crashes:\n", "".join(crashes)]
    return "\n".join(parts)


def _scores_table(rated: Scores) -> str:
    heads = ["method", "interquartile mean of scores", f"{CONFIDENCE:.0%} interval", "runs"]
    rows = []
    for name, by_task in rated.items():
        values = list(by_task.values())
        low, high = interval(interquartile_mean(resampled(values)))
        mean = interquartile_mean(np.concatenate(values))
        rows.append([name, f"{mean:.3f}", f"{low:.3f} - {high:.3f}", str(sum(map(len, values)))])
    return _markdown(heads, rows)


def _task_table(runs: Sequence[Trained]) -> str:
    """Return the table of one task, without columns that no run has a value for."""
    order = ("hypervolume", SHARE, *map(words, INDICATORS), SPEED)
    known = [name for name in order if any(name in run.measures() for run in runs)]
    rows = []
    for method in dict.fromkeys(run.method for run in runs):
        own = [run for run in runs if run.method == method]
        measured = [run.measures() for run in own]
        cells = [_spread([m[name] for m in measured if name in m]) for name in known]
        crashes = sum(bool(run.error) for run in own)
        rows.append([method, *cells, str(len(own)), str(crashes)])
    return _markdown(["method", *known, "runs", "crashes"], rows)


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _spread(values: Sequence[float]) -> str:
    """Format median and quartiles."""
    if not values:
        return ""
    low, middle, high = (f"{value:.4g}" for value in np.quantile(values, QUARTILES))
    return f"{middle} ({low} - {high})" if len(values) > 1 else middle


def hypervolume_figure(runs: Sequence[Trained]) -> Figure:
    """Plot the best hypervolume so far against environment steps and training seconds.

    Each method has its median over runs and its interquartile range, and each task a row of plots.
    The reference, which may train longer, is a horizontal line.
    """
    tasks = list(dict.fromkeys(run.task for run in runs))
    looks = _looks(dict.fromkeys(run.method for run in runs if not run.reference))
    figure = blank(9.0, 0.6 + 3.1 * len(tasks), "")
    for task, row in zip(tasks, figure.subplots(len(tasks), 2, squeeze=False), strict=True):
        own = [run for run in runs if run.task == task]
        for axes, (scale, label) in zip(row, SCALES, strict=True):
            for name, look in looks.items():
                curves = [(getattr(r, scale), r.hypervolume) for r in own if r.method == name]
                if curves:
                    x, (low, middle, high) = band(curves)
                    axes.plot(x, middle, drawstyle="steps-post", label=name, **look)
                    color = look["color"]
                    axes.fill_between(x, low, high, step="post", color=color, alpha=0.2, lw=0)
            if own[0].reference_hypervolume is not None:
                line = {"color": "0.3", "lw": 0.9, "label": "reference"}
                axes.axhline(own[0].reference_hypervolume, **line)
            axes.set_xlabel(label)
            axes.set_title(title(task))
            lattice(axes)
        row[0].set_ylabel("hypervolume")
    legend_outside(figure)
    return figure


def profile_figure(rated: Scores) -> Figure:
    """Plot performance profiles over all tasks, with pointwise bootstrap bands."""
    figure = blank(6.4, 4.2, "")
    axes = figure.add_subplot()
    most = max(values.max() for by_task in rated.values() for values in by_task.values())
    thresholds = np.linspace(0, 1.02 * most, THRESHOLDS)
    for name, look in _looks(rated).items():
        values = list(rated[name].values())
        low, high = interval(profile(resampled(values), thresholds))
        axes.plot(thresholds, profile(np.concatenate(values), thresholds), label=name, **look)
        axes.fill_between(thresholds, low, high, color=look["color"], alpha=0.2, lw=0)
    axes.set_xlabel("normalized hypervolume (τ)")
    axes.set_ylabel("share of runs above τ")
    lattice(axes)
    legend_outside(figure)
    return figure


def mean_figure(rated: Scores) -> Figure:
    """Plot each method's interquartile mean over all tasks, with its bootstrap interval."""
    figure = blank(6.4, 1.0 + 0.5 * len(rated), "")
    axes = figure.add_subplot()
    axes.use_sticky_edges = False  # else the lowest bar touches the frame
    for place, (name, look) in enumerate(_looks(rated).items()):
        values = list(rated[name].values())
        low, high = interval(interquartile_mean(resampled(values)))
        axes.barh(place, high - low, left=low, height=0.5, color=look["color"], alpha=0.35)
        mean = interquartile_mean(np.concatenate(values))
        axes.plot([mean, mean], [place - 0.25, place + 0.25], color=look["color"], lw=2)
    axes.set_yticks(range(len(rated)), list(rated))
    axes.invert_yaxis()
    axes.set_xlabel(f"interquartile mean of normalized hypervolume, {CONFIDENCE:.0%} interval")
    lattice(axes)
    return figure


def _looks(methods: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return a color and a line style for each method."""
    names = list(methods)
    looks = distinct(len(names))
    return {
        name: {"color": look["color"], "linestyle": look["linestyle"], "lw": 1.6}
        for name, look in zip(names, looks, strict=True)
    }
