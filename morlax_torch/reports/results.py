"""Write the results of an evaluation: fronts, figures, tables and a report."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..configuration.config import Config
from ..envs.naming import title
from ..evaluation import figures
from ..evaluation.front import Front, hypervolume_in
from ..host.files import make_folder, write_file
from ..runs.hardware import Machine
from ..runs.progress import History
from .comparison import Evaluated, quartiles
from .page import report
from .verdict import verdict_of

MOST_NAMES = 4  # in a title


def facts(
    config: Config,
    history: History | None,
    measures: Mapping[str, float],
    machines: Sequence[Machine] = (),
) -> dict[str, str]:
    found = {
        "algorithm": config.algorithm,
        "random seed": str(config.seed),
        "device": config.device or "unknown",
        "parallel worlds": f"{config.worlds:,}",
    }
    if history is not None:
        found["environment steps"] = steps(float(history.env_steps[-1]))
        found["training time"] = duration(float(history.train_seconds[-1]))
    name = hypervolume_in(measures)
    found[name.replace("_", ", ")] = f"{measures[name]:.4g}"
    if machines:
        found["trained on"] = in_order(machine.hardware() for machine in machines)
        found["trained with"] = in_order(machine.software() for machine in machines)
    return found


def in_order(names: Iterable[str]) -> str:
    """Join names, each as often as it follows another one."""
    return "; then ".join(name for name, _ in groupby(names))


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
    found: Mapping[str, Evaluated],
    folder: Path,
    about: str,
    typed: str,
    portrait: bytes | None = None,
) -> None:
    """Write fronts, figures, tables and the report; each of several runs gets a subfolder.

    For the arguments see `report`.
    """
    drawn: list[tuple[str, Figure]] = []
    fronts: dict[str, Figure] = {}
    several = len(found) > 1
    task = title(next(iter(found.values())).policy.config.env)
    histories = [run.history for run in found.values() if run.history is not None]
    counted = {run.policy.config.evaluation.protocol for run in found.values()}
    make_folder(folder)
    if several:
        overlaid = figures.fronts_figure({name: run.front for name, run in found.items()}, task)
        figures.save(overlaid, folder / "fronts")
        drawn.append(
            ("Fronts of all runs, without policies dominated within their own run.", overlaid)
        )
    if histories and len(counted) == 1:
        curves = figures.hypervolume_figure(histories, task)
        figures.save(curves, folder / "hypervolume")
        drawn.append(("Hypervolume during training.", curves))
    for name, run in found.items():
        place = folder / name if several else folder
        make_folder(place)
        run.front.save(place / "front.npz")
        write_rows(place / "front.csv", front_rows(run.front))
        for stem, caption, figure in pictures(run.front, f"{task}: {name}"):
            figures.save(figure, place / stem)
            if stem == "front":
                fronts[name] = figure
            else:
                drawn.append((f"{name}: {caption}", figure))
    summary = quartiles([run.measures for run in found.values()]) if several else {}
    write_rows(folder / "indicators.csv", indicator_rows(found))
    if several:
        heads = ["indicator", "lower_quartile", "median", "upper_quartile", "runs"]
        rows = ([name, *three, len(found)] for name, three in summary.items())
        write_rows(folder / "summary.csv", [heads, *rows])
    heading = f"{task}: {', '.join(found) if len(found) <= MOST_NAMES else f'{len(found)} runs'}"
    known = {
        name: {"checkpoint": run.front.checkpoint}
        | facts(run.policy.config, run.history, run.measures, run.machines)
        for name, run in found.items()
    }
    said = verdict_of(found)
    text = report(heading, said, about, typed, found, summary, fronts, drawn, known, portrait)
    write_file(folder / "report.html", text)


def pictures(front: Front, title: str) -> list[tuple[str, str, Figure]]:
    """Return file name, caption and figure of every picture of one front."""
    reached = "returns of every trade-off, colored by trade-off."
    asked = "return of each objective against the trade-off."
    found = [
        ("front", reached, figures.front_figure(front, title)),
        ("returns", asked, figures.returns_figure(front, title)),
    ]
    if len(front.objectives) > 3:
        lines, best = len(figures.shown_lines(front)), int(front.non_dominated.sum())
        caption = f"the front, one line per policy: {lines} of {best}."
        found.append(("parallel", caption, figures.parallel_figure(front, title)))
    if front.quantities is not None:
        caption = "what each policy does, in physical units, colored by trade-off."
        found.append(("quantities", caption, figures.quantities_figure(front, title)))
    return found


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


def indicator_rows(found: Mapping[str, Evaluated]) -> list[list]:
    rows: list[list] = [["run", "path", "env", "seed", *next(iter(found.values())).measures]]
    for name, run in found.items():
        config = run.policy.config
        rows.append([*map(cell, (name, run.path, config.env)), config.seed, *run.measures.values()])
    return rows


def cell(name: str) -> str:
    """Quote a name that a spreadsheet would run as a formula."""
    return f"'{name}" if name.startswith(("=", "+", "-", "@", "\t", "\r")) else name


def write_rows(path: Path, rows: Iterable[Sequence]) -> None:
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    write_file(path, text.getvalue())
