"""Figures of evaluated runs and a LaTeX table of their indicators; nothing is simulated."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl

from ..envs import MorlaxError
from ..envs.naming import movable, title
from ..evaluation import figures
from ..evaluation.front import representatives
from ..host.files import make_folder, write_file
from ..runs.loading import find_run, load, load_front
from ..runs.progress import History
from . import comparison
from .comparison import Evaluated, Quartiles
from .page import words

VECTORS = ("pdf", "svg")
WIDTHS = {"paper": 3.5, "screen": None}  # in inches; None: as wide as the plots need
NARROWEST, WIDEST = 2.0, 20.0
SPECIAL = {
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
Row = tuple[str, str]  # task and algorithm


def write_figures(
    runs: Sequence[str], folder: Path, style: str = "paper", width: float | None = None
) -> None:
    """Write the figures of runs as .pdf and .svg, and indicators.tex.

    Each run has a figure of its front, in a subfolder if there are several runs; each task has one
    that overlays its fronts, and each algorithm of a task one of the hypervolume.

    Args:
        runs: run folders, checkpoint files, or shipped policies, each with a front.
        folder: where to write.
        style: a name of `figures.STYLES`.
        width: width of each figure, in inches (None: that of the style).

    Raises:
        MorlaxError: a run or its front cannot be loaded, runs of a task cannot be compared, or the
            width is out of range.
    """
    width = WIDTHS[style] if width is None else width
    if width is not None and not NARROWEST <= width <= WIDEST:
        raise MorlaxError(
            f"the width must be from {NARROWEST:g} to {WIDEST:g} inches, not {width:g}."
        )
    found = {name: _evaluated(run) for name, run in zip(comparison.names(runs), runs, strict=True)}
    rows = _grouped(found)
    tasks = {task: _of_task(rows, task) for task, _ in rows}
    for group in tasks.values():
        policies = {name: run.policy for name, run in group.items()}
        comparison.check_comparable(policies)
        comparison.own_protocol(policies)
    make_folder(folder)
    with mpl.rc_context(figures.STYLES[style]):
        for name, run in found.items():
            place = folder / name if len(found) > 1 else folder
            make_folder(place)
            drawn = figures.front_figure(run.front, "", width, representatives(run.front))
            figures.save(drawn, place / "front", VECTORS)
        for task, group in tasks.items():
            if len(group) > 1:
                fronts = {_label(name, run): run.front for name, run in group.items()}
                drawn = figures.fronts_figure(fronts, "", width)
                figures.save(drawn, folder / f"fronts-{_plain(task)}", VECTORS)
        for (task, algorithm), group in rows.items():
            histories = [run.history for run in group.values() if run.history is not None]
            if histories:
                drawn = figures.hypervolume_figure(histories, "", width)
                figures.save(drawn, folder / f"hypervolume-{_plain(task)}-{algorithm}", VECTORS)
    write_file(folder / "indicators.tex", latex(rows))


def latex(rows: Mapping[Row, Mapping[str, Evaluated]]) -> str:
    """Return the table of indicators: the median and quartiles over the runs of each row."""
    measured = {row: _quartiles(group, _of_task(rows, row[0])) for row, group in rows.items()}
    names = list(dict.fromkeys(name for own in measured.values() for name in own))
    lines = [
        "% Median [lower quartile, upper quartile] over runs; needs \\usepackage{booktabs}",
        f"\\begin{{tabular}}{{lll{'r' * len(names)}}}",
        "\\toprule",
        _line(["task", "algorithm", "seeds", *map(words, names)]),
        "\\midrule",
    ]
    for (task, algorithm), group in rows.items():
        seeds = sorted(run.policy.config.seed for run in group.values())
        own = measured[task, algorithm]
        cells = [_cell(own[name], len(group)) if name in own else "--" for name in names]
        lines.append(_line([title(task), algorithm, ", ".join(map(str, seeds))], cells))
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}\n"])


def _evaluated(run: str) -> Evaluated:
    policy, front = load(run), load_front(run)
    curve = find_run(run) / "metrics.csv"
    history = History.load(curve) if curve.is_file() else None
    return Evaluated(run, policy, front, history, {})


def _grouped(found: Mapping[str, Evaluated]) -> dict[Row, dict[str, Evaluated]]:
    """Return the runs of each task and algorithm, in the order in which they are named."""
    rows: dict[Row, dict[str, Evaluated]] = {}
    for name, run in found.items():
        config = run.policy.config
        rows.setdefault((movable(config.env), config.algorithm), {})[name] = run
    return rows


def _of_task(rows: Mapping[Row, Mapping[str, Evaluated]], task: str) -> dict[str, Evaluated]:
    return {
        name: run for (env, _), group in rows.items() if env == task for name, run in group.items()
    }


def _label(name: str, run: Evaluated) -> str:
    return f"{run.policy.config.algorithm}, {name}"


def _plain(task: str) -> str:
    """Return a task's name as a part of the name of a file."""
    return re.sub(r"[^\w.-]+", "-", title(task))


def _quartiles(
    group: Mapping[str, Evaluated], rivals: Mapping[str, Evaluated]
) -> dict[str, Quartiles]:
    """Return quartiles of the indicators that all runs have; IGD+ refers to all runs of a task."""
    target = comparison.union([run.front for run in rivals.values()]) if len(rivals) > 1 else None
    first, *others = [run.front.indicators(target) for run in group.values()]
    shared = [name for name in first if all(name in other for other in others)]
    return comparison.quartiles([{name: one[name] for name in shared} for one in (first, *others)])


def _line(texts: Sequence[str], cells: Sequence[str] = ()) -> str:
    escaped = ["".join(SPECIAL.get(letter, letter) for letter in text) for text in texts]
    return " & ".join([*escaped, *cells]) + " \\\\"


def _cell(values: Quartiles, runs: int) -> str:
    """Return three digits of the median, with the quartiles of several runs, and one exponent."""
    size = math.floor(math.log10(abs(values.median))) if values.median else 0
    exponent = size if size >= 4 or size <= -3 else 0
    low, median, high = (f"{v / 10**exponent:.{max(0, 2 - size + exponent)}f}" for v in values)
    text = f"{median}\\ [{low}, {high}]" if runs > 1 else median
    return f"${text} \\times 10^{{{exponent}}}$" if exponent else f"${text}$"
