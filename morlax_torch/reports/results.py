"""Write the results of an evaluation: fronts, figures, tables and a report."""

from collections.abc import Mapping, Sequence
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
    texts = {
        "algorithm": config.algorithm,
        "random seed": str(config.seed),
        "device": config.device or "unknown",
        "parallel worlds": f"{config.worlds:,}",
    }
    if history is not None:
        texts["environment steps"] = steps(float(history.env_steps[-1]))
        texts["training time"] = duration(float(history.train_seconds[-1]))
    name = hypervolume_in(measures)
    texts[name.replace("_", ", ")] = f"{measures[name]:.4g}"
    if machines:  # each named as often as it follows another one
        for key, parts in (
            ("trained on", [machine.hardware() for machine in machines]),
            ("trained with", [machine.software() for machine in machines]),
        ):
            texts[key] = "; then ".join(part for part, _ in groupby(parts))
    return texts


def steps(number: float) -> str:
    """Format a number of environment steps, such as 8,192 or 12.5 M."""
    return f"{number:,.0f}" if number < 1e6 else f"{number / 1e6:,.1f} M"


def duration(seconds: float) -> str:
    """Format a time span, such as 42 s, 3 min 05 s or 2 h 10 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


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
    make_folder(folder)
    if several:
        overlaid = figures.fronts_figure({n: run.front for n, run in evaluations.items()}, task)
        figures.save(overlaid, folder / "fronts")
        drawn.append(
            ("Fronts of all runs, without policies dominated within their own run.", overlaid)
        )
    if histories and len({run.policy.config.evaluation.protocol for run in runs}) == 1:
        curves = figures.hypervolume_figure(histories, task)
        figures.save(curves, folder / "hypervolume")
        drawn.append(("Hypervolume during training.", curves))
    for name, run in evaluations.items():
        subfolder = folder / name if several else folder
        make_folder(subfolder)
        run.front.save(subfolder / "front.npz")
        write_rows(subfolder / "front.csv", front_rows(run.front))
        fronts[name] = figures.front_figure(run.front, f"{task}: {name}")
        figures.save(fronts[name], subfolder / "front")
        for stem, caption, figure in pictures(run.front, f"{task}: {name}"):
            figures.save(figure, subfolder / stem)
            drawn.append((f"{name}: {caption}", figure))
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
    number = len(runs)
    heading = f"{task}: {', '.join(evaluations) if number <= MOST_NAMES else f'{number} runs'}"
    told = {
        name: {"checkpoint": run.front.checkpoint}
        | facts(run.policy.config, run.history, run.measures, run.machines)
        for name, run in evaluations.items()
    }
    settings = dict.fromkeys(name for texts in told.values() for name in texts)
    objectives = runs[0].front.objectives
    report = page.rendered(
        "report.html",
        title=heading,
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
        settings=[[name, *(texts.get(name, "") for texts in told.values())] for name in settings],
        portrait=portrait and page.data_url("png", portrait),
        configs={name: write_yaml(run.policy.config) for name, run in evaluations.items()},
        heads=["", *evaluations, *(("median", "quartiles") if several else ()), ""],
        indicators=[
            [page.words(name), *cells, page.meaning(name)] for name, *cells in indicator_rows(runs)
        ],
    )
    write_file(folder / "report.html", report)


def indicator_rows(runs: Sequence[Evaluated]) -> list[list[str]]:
    """Return each indicator's name and values, of several runs with the median and quartiles."""
    rows = [[name, *(page.number(run.measures[name]) for run in runs)] for name in runs[0].measures]
    if len(runs) > 1:
        for row, values in zip(rows, quartiles([r.measures for r in runs]).values(), strict=True):
            low, median, high = map(page.number, values)
            row += [median, f"{low} - {high}"]
    return rows


def pictures(front: Front, title: str) -> list[tuple[str, str, Figure]]:
    """Return file name, caption and figure of every picture of one front beside that of itself."""
    asked = "return of each objective against the trade-off."
    drawn = [("returns", asked, figures.returns_figure(front, title))]
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
