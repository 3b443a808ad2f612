"""Figures of evaluated runs and a LaTeX table of their indicators; nothing is simulated."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from ..envs.naming import movable, title
from ..evaluation import figures
from ..evaluation.front import representatives
from ..host.files import make_folder, write_file
from ..runs.loading import load, load_front
from . import comparison
from .comparison import Evaluated, Quartiles
from .page import rendered, words

VECTORS = ("pdf", "svg")
WIDTHS = {"paper": 3.5, "screen": None}  # in inches; None: as wide as the plots need
Row = tuple[str, str]  # task and algorithm


def write_figures(
    runs: Sequence[str], folder: Path, style: str = "paper", width: float | None = None
) -> None:
    """Write the figures of runs as .pdf and .svg, and indicators.tex.

    Each run has a figure of its front, in a subfolder if there are several runs; each task has one
    that overlays its fronts, and each algorithm of a task one of the hypervolume. `style` is a name
    of `figures.STYLES`, `width` in inches (None: that of the style).
    """
    width = WIDTHS[style] if width is None else width
    evaluations = {
        name: Evaluated(run, load(run), load_front(run), comparison.history_of(run), {})
        for name, run in zip(comparison.names(runs), runs, strict=True)
    }
    rows: dict[Row, dict[str, Evaluated]] = {}
    tasks: dict[str, dict[str, Evaluated]] = {}
    for name, run in evaluations.items():
        task, algorithm = movable(run.policy.config.env), run.policy.config.algorithm
        rows.setdefault((task, algorithm), {})[name] = run
        tasks.setdefault(task, {})[name] = run
    for group in tasks.values():
        comparison.check_comparable({name: run.policy for name, run in group.items()})
    make_folder(folder)

    def save(figure: Figure, stem: str) -> None:
        figures.save(figure, folder / re.sub(r"[^\w.-]+", "-", stem), VECTORS)

    with mpl.rc_context(figures.STYLES[style]):
        for name, run in evaluations.items():
            subfolder = folder / name if len(evaluations) > 1 else folder
            make_folder(subfolder)
            drawn = figures.front_figure(run.front, "", width, representatives(run.front))
            figures.save(drawn, subfolder / "front", VECTORS)
        for task, group in tasks.items():
            if len(group) > 1:
                fronts = {f"{r.policy.config.algorithm}, {n}": r.front for n, r in group.items()}
                save(figures.fronts_figure(fronts, "", width), f"fronts-{title(task)}")
        for (task, algorithm), group in rows.items():
            histories = [run.history for run in group.values() if run.history is not None]
            if histories:
                drawn = figures.hypervolume_figure(histories, "", width)
                save(drawn, f"hypervolume-{title(task)}-{algorithm}")
    write_file(folder / "indicators.tex", latex(rows))


def latex(rows: Mapping[Row, Mapping[str, Evaluated]]) -> str:
    """Return the table of indicators: the median and quartiles over the runs of each row."""
    measured: dict[Row, dict[str, Quartiles]] = {}
    for row, group in rows.items():
        rivals = [runs for other, runs in rows.items() if other[0] == row[0]]
        fronts = [run.front for runs in rivals for run in runs.values()]
        target = comparison.union(fronts) if len(fronts) > 1 else None  # of IGD+
        indicators = [run.front.indicators(target) for run in group.values()]
        measured[row] = comparison.quartiles(indicators)
    names = list(dict.fromkeys(name for values in measured.values() for name in values))
    lines = []
    for (task, algorithm), group in rows.items():
        seeds = sorted(run.policy.config.seed for run in group.values())
        texts = title(task), algorithm, ", ".join(map(str, seeds))
        values = measured[task, algorithm]
        cells = [_cell(values[name], len(group)) if name in values else "--" for name in names]
        lines.append([*map(_escaped, texts), *cells])
    heads = [_escaped(words(name)) for name in names]
    return rendered("indicators.tex", names=heads, rows=lines)


def _escaped(text: str) -> str:
    return re.sub(r"[&%$#_{}]", r"\\\g<0>", text)


def _cell(values: Quartiles, runs: int) -> str:
    """Return three digits of the median, with the quartiles of several runs, and one exponent."""
    size = math.floor(math.log10(abs(values[1]))) if values[1] else 0
    exponent = size if size >= 4 or size <= -3 else 0
    low, median, high = (f"{v / 10**exponent:.{max(0, 2 - size + exponent)}f}" for v in values)
    text = f"{median}\\ [{low}, {high}]" if runs > 1 else median
    return f"${text} \\times 10^{{{exponent}}}$" if exponent else f"${text}$"
