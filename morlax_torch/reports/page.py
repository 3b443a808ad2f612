"""Files of evaluated runs: figures, tables and HTML pages, from the templates of this folder."""

import base64
import io
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from functools import cache
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from ..configuration.files import write_yaml
from ..envs import get
from ..envs.naming import title
from ..evaluation import figures
from ..evaluation.front import Front, hypervolume_in, representatives
from ..evaluation.requirements import Choice
from ..evaluation.style import FALLS, FILES, NON_DOMINATED, of_objectives
from ..host.files import make_folder, write_file, write_rows
from ..host.version import __version__
from ..networks.policy import Policy
from ..runs.checkpoint import fingerprint
from ..runs.choosing import CONDITIONS, trials
from ..runs.loading import find_checkpoint
from . import comparison
from .comparison import Evaluated, quartiles
from .verdict import verdict_of

MOST_NAMES = 4  # in a title


def number(value: float) -> str:
    return f"{value:,.4g}"


def words(measure: str) -> str:
    return "IGD+" if measure == "igd_plus" else measure.replace("_", " ")


@cache
def _templates() -> Environment:
    templates = Environment(
        loader=PackageLoader(str(__package__), ""),
        autoescape=lambda name: name is not None and name.endswith(".html"),
        trim_blocks=True,
        undefined=StrictUndefined,
    )
    for function in (chart, data_url, number, representatives, svg, words):
        templates.filters[function.__name__] = function
    templates.filters["yaml"] = write_yaml
    return templates


def rendered(template: str, **values: Any) -> str:
    return _templates().get_template(template).render(values)


def data_url(content: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def chart(figure: Figure, front: Front) -> str:
    """Return a figure of a front as SVG for HTML. page.js shows the policy a user points at."""
    best, fails = front.non_dominated, front.fails
    drawn_as = {NON_DOMINATED: best & ~fails, "dominated": ~best & ~fails, FALLS["label"]: fails}
    shown = {label: np.flatnonzero(some) for label, some in drawn_as.items()}
    for axes in figure.axes:
        for points in axes.collections:
            if (indices := shown.get(str(points.get_label()))) is not None and axes.name != "3d":
                points.set_urls([f"#{index}" for index in indices])
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)
    names, values = front.shown + front.quantity_names, front.values

    def described(link: re.Match[str]) -> str:
        policy = int(link[1])
        weights = [f"{n} {w:.2f}" for n, w in zip(front.shown, shares[policy], strict=True)]
        returns = [f"{n} {v:,.4g}" for n, v in zip(names, values[policy], strict=True)]
        text = escape(f"weights: {', '.join(weights)}; returns: {', '.join(returns)}")
        return f'<a href="#{policy}"><title>{text}</title>'

    drawn = re.sub(r'<a xlink:href="#(\d+)" target="_blank">', described, svg(figure).decode())
    # HTML needs no namespaces, and the metadata names websites
    return re.sub(
        r"<metadata>.*?</metadata>|^.*?(?=<svg)| xmlns(:\w+)?=\"[^\"]*\"", "", drawn, flags=re.S
    )


def svg(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    with mpl.rc_context(FILES):
        figure.savefig(drawn, format="svg", metadata={"Date": None})
    return drawn.getvalue()


def card(
    run: str,
    policy: Policy,
    choice: Choice,
    commands: Sequence[str],
    strip: Callable[[Policy, Sequence[float]], bytes | None],
    seed: int = 0,
) -> str:
    """Return the decision card: why a trade-off was chosen, and what its policy does.

    The choice is also simulated under other conditions. `commands` are command lines that use it,
    and `strip` draws a film strip of a policy on the CPU, where it stays, as PNG.
    """
    required, task = choice.required, policy.config.env
    tried, titles = trials(policy, choice.tradeoff, seed), get(task).titles
    # a fall breaks every requirement
    missed = [
        name
        for name, trial in tried.items()
        if trial.falls or not required.kept(trial.values[None])[0]
    ]
    return rendered(
        "card.html",
        task=title(task),
        choice=choice,
        maximized=required.maximized,
        titles=[titles.get(name, name) for name in required.names],
        rows=[[titles.get(name, name), *row] for name, *row in choice.rows(",.4g")],
        strip=strip(policy.cpu(), choice.tradeoff),
        trials=tried,
        missed=missed,
        conditions=CONDITIONS,
        origin={
            "run": run,
            "checkpoint": str(find_checkpoint(run)),
            "fingerprint of the policies": fingerprint(policy.agent.state_dict()),
            "morlax-torch": __version__,
        },
        commands=commands,
    )


def facts(run: Evaluated) -> dict[str, str]:
    """Return how a run was trained, as texts by name."""
    config, history = run.policy.config, run.history
    texts = {
        "checkpoint": run.front.checkpoint,
        "algorithm": config.algorithm,
        "random seed": str(config.seed),
        "device": config.device or "unknown",
        "parallel worlds": f"{config.worlds:,}",
    }
    if history is not None:
        texts["environment steps"] = f"{history.env_steps[-1]:,.0f}"
        texts["training time"] = str(timedelta(seconds=round(float(history.train_seconds[-1]))))
    name = hypervolume_in(run.measures)
    texts[name.replace("_", ", ")] = number(run.measures[name])
    if run.machines:  # each named as often as it follows another one
        hardware = (machine.hardware() for machine in run.machines)
        software = (machine.software() for machine in run.machines)
        texts["trained on"] = "; then ".join(part for part, _ in groupby(hardware))
        texts["trained with"] = "; then ".join(part for part, _ in groupby(software))
    return texts


def write(evaluations: Mapping[str, Evaluated], folder: Path, values: Mapping[str, Any]) -> None:
    """Write fronts, figures, tables and the report; each of several runs gets a subfolder.

    `values` are those of report.html that are not of a run.
    """
    drawn: list[tuple[str, Figure]] = []
    fronts: dict[str, Figure] = {}
    runs, several = list(evaluations.values()), len(evaluations) > 1
    repeated = comparison.repeated(evaluations)
    task = title(runs[0].policy.config.env)
    histories = {name: run.history for name, run in evaluations.items() if run.history}
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
        curves = figures.hypervolume_figure(histories, repeated, task)
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
    if repeated:
        heads = ["indicator", "lower_quartile", "median", "upper_quartile", "runs"]
        summary = quartiles([run.measures for run in runs])
        quarters = ([name, *three, len(runs)] for name, three in summary.items())
        write_rows(folder / "summary.csv", [heads, *quarters])
    shown = ", ".join(evaluations) if len(runs) <= MOST_NAMES else f"{len(runs)} runs"
    training = {name: facts(run) for name, run in evaluations.items()}
    objectives = runs[0].front.shown
    report = rendered(
        "report.html",
        title=f"{task}: {shown}",
        verdict=verdict_of(evaluations),
        **values,
        colors=dict(zip(objectives, of_objectives(len(objectives)), strict=True)),
        runs=evaluations,
        fronts=fronts,
        figures=drawn,
        training=training,
        settings=dict.fromkeys(name for texts in training.values() for name in texts),
        repeated=repeated,
        indicators=indicator_cells(evaluations),
    )
    write_file(folder / "report.html", report)


def indicator_cells(runs: Mapping[str, Evaluated]) -> dict[str, list[str]]:
    """Return the values of each indicator, of repeated runs with the median and quartiles."""
    measured = [run.measures for run in runs.values()]
    cells = {name: [number(values[name]) for values in measured] for name in measured[0]}
    if comparison.repeated(runs):
        for name, values in quartiles(measured).items():
            low, median, high = map(number, values)
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
    if len(front.quantity_names) > 1:  # they are plotted against the first
        caption = "what each policy does, in physical units, colored by trade-off."
        drawn.append(("quantities", caption, figures.quantities_figure(front, title)))
    return drawn


def front_rows(front: Front) -> list[list]:
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
