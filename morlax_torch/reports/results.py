"""Write the results of an evaluation: fronts, figures, tables and a report."""

from collections.abc import Mapping, Sequence
from datetime import timedelta
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..configuration.config import Config
from ..configuration.files import write_yaml
from ..envs.naming import title
from ..evaluation import figures
from ..evaluation.front import Front, hypervolume_in
from ..evaluation.style import of_objectives
from ..host.files import make_folder, write_file, write_rows
from ..runs.hardware import Machine
from ..runs.progress import History
from . import page
from .comparison import Evaluated, quartiles
from .verdict import verdict_of

MOST_NAMES = 4  # in a title


def facts(
    config: Config,
    history: History | None,
    measures: Mapping[str, float],
    machines: Sequence[Machine] = (),
) -> dict[str, str]:
    """Return how a run was trained, as texts by name."""
    texts = {
        "algorithm": config.algorithm,
        "random seed": str(config.seed),
        "device": config.device or "unknown",
        "parallel worlds": f"{config.worlds:,}",
    }
    if history is not None:
        texts["environment steps"] = f"{history.env_steps[-1]:,.0f}"
        texts["training time"] = str(timedelta(seconds=round(float(history.train_seconds[-1]))))
    name = hypervolume_in(measures)
    texts[name.replace("_", ", ")] = page.number(measures[name])
    if machines:  # each named as often as it follows another one
        for key, parts in (
            ("trained on", [machine.hardware() for machine in machines]),
            ("trained with", [machine.software() for machine in machines]),
        ):
            texts[key] = "; then ".join(part for part, _ in groupby(parts))
    return texts


def write(
    evaluations: Mapping[str, Evaluated],
    folder: Path,
    about: str,
    typed: str,
    portrait: bytes | None = None,
) -> None:
    """Write fronts, figures, tables and the report; each of several runs gets a subfolder.

    `about` says how runs, by name, were evaluated, `typed` is the command line, and `portrait` a
    picture of the robot as PNG.
    """
    drawn: list[tuple[str, Figure]] = []
    fronts: dict[str, Figure] = {}
    runs, several = list(evaluations.values()), len(evaluations) > 1
    task = title(runs[0].policy.config.env)
    histories = [run.history for run in runs if run.history is not None]
    protocols = {run.policy.config.evaluation.protocol for run in runs}

    def save(path: Path, caption: str, figure: Figure) -> None:
        figures.save(figure, path)
        drawn.append((caption, figure))

    make_folder(folder)
    if several:
        overlaid = figures.fronts_figure({n: run.front for n, run in evaluations.items()}, task)
        caption = "Fronts of all runs, without policies dominated within their own run."
        save(folder / "fronts", caption, overlaid)
    if histories and len(protocols) == 1:
        curves = figures.hypervolume_figure(histories, task)
        save(folder / "hypervolume", "Hypervolume during training.", curves)
    for name, run in evaluations.items():
        subfolder, heading = folder / name if several else folder, f"{task}: {name}"
        make_folder(subfolder)
        run.front.save(subfolder / "front.npz")
        write_rows(subfolder / "front.csv", front_rows(run.front))
        fronts[name] = figures.front_figure(run.front, heading)
        figures.save(fronts[name], subfolder / "front")
        for stem, caption, figure in pictures(run.front, heading):
            save(subfolder / stem, f"{name}: {caption}", figure)
    rows: list[list] = [["run", "path", "env", "seed", *runs[0].measures]]
    for name, run in evaluations.items():
        config = run.policy.config
        rows.append([*map(cell, (name, run.path, config.env)), config.seed, *run.measures.values()])
    write_rows(folder / "indicators.csv", rows)
    if several:
        heads = ["indicator", "lower_quartile", "median", "upper_quartile", "runs"]
        summary = quartiles([run.measures for run in runs])
        quarters = ([name, *three, len(runs)] for name, three in summary.items())
        write_rows(folder / "summary.csv", [heads, *quarters])
    shown = ", ".join(evaluations) if len(runs) <= MOST_NAMES else f"{len(runs)} runs"
    told = {
        name: {"checkpoint": run.front.checkpoint}
        | facts(run.policy.config, run.history, run.measures, run.machines)
        for name, run in evaluations.items()
    }
    objectives = runs[0].front.objectives
    report = page.rendered(
        "report.html",
        title=f"{task}: {shown}",
        verdict=verdict_of(evaluations),
        about=about,
        command=typed,
        colors=dict(zip(objectives, of_objectives(len(objectives)), strict=True)),
        fronts={n: page.front_part(run.front, fronts[n]) for n, run in evaluations.items()},
        # an <img> keeps the ids of one SVG apart from those of the others
        figures=[
            (caption, page.data_url("svg+xml", page.svg(figure).encode()), page.width(figure))
            for caption, figure in drawn
        ],
        runs=told,
        settings=dict.fromkeys(name for texts in told.values() for name in texts),
        portrait=portrait and page.data_url("png", portrait),
        configs={name: write_yaml(run.policy.config) for name, run in evaluations.items()},
        indicators=indicator_cells(runs),
    )
    write_file(folder / "report.html", report)


def indicator_cells(runs: Sequence[Evaluated]) -> dict[str, list[str]]:
    """Return the values of each indicator, of several runs with the median and quartiles."""
    measured = [run.measures for run in runs]
    cells = {name: [page.number(values[name]) for values in measured] for name in measured[0]}
    if len(runs) > 1:
        for name, values in quartiles(measured).items():
            low, median, high = map(page.number, values)
            cells[name] += [median, f"{low} - {high}"]
    return cells


def pictures(front: Front, title: str) -> list[tuple[str, str, Figure]]:
    """Return file name, caption and figure of every picture of one front beside that of itself."""
    caption = "return of each objective against the trade-off."
    drawn = [("returns", caption, figures.returns_figure(front, title))]
    if len(front.objectives) > 3:
        lines, best = len(figures.shown_lines(front)), int(front.non_dominated.sum())
        caption = f"the front, one line per policy: {lines} of {best}."
        drawn.append(("parallel", caption, figures.parallel_figure(front, title)))
    if front.quantities is not None:
        caption = "what each policy does, in physical units, colored by trade-off."
        drawn.append(("quantities", caption, figures.quantities_figure(front, title)))
    return drawn


def front_rows(front: Front) -> list[list]:
    assert front.falls is not None
    heads = [
        *(f"tradeoff_{name}" for name in front.objectives),
        *(f"return_{name}" for name in front.objectives),
        *front.quantity_names,
        *("length", "falls", "non_dominated", "obeys"),
    ]
    numbers = np.column_stack([front.tradeoffs, front.values]).tolist()
    marks = np.column_stack([front.lengths, front.falls, front.non_dominated, front.obeys])
    pairs = zip(numbers, marks, strict=True)
    return [heads, *([*row, *(f"{mark:g}" for mark in some)] for row, some in pairs)]


def cell(name: str) -> str:
    """Quote a name that a spreadsheet would run as a formula."""
    return f"'{name}" if name.startswith(("=", "+", "-", "@", "\t", "\r")) else name
