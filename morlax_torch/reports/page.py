"""The report of an evaluation: one self-contained HTML file, from the template report.html."""

import base64
import io
import re
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from typing import Any

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from ..configuration.files import write_yaml
from ..evaluation.figures.colors import of_objectives
from ..evaluation.figures.style import FILES, NON_DOMINATED
from ..evaluation.front import Front, representatives
from .comparison import Evaluated, Quartiles

MEANINGS = {
    "hypervolume": "volume between the reference point and the front; higher is better",
    "hypervolume_approximate": "hypervolume, approximated by moocore; higher is better",
    "sparsity": "mean squared gap between neighbors on the front; lower is denser",
    "expected_utility": "mean over trade-offs of the best w · r on the front; higher is better",
    "cardinality": "number of non-dominated policies",
    "obedience": "share of trade-offs for which no other policy is clearly better than their own",
    "fall_rate": "share of episodes in which the robot failed",
    "blowup_rate": "share of episodes that left sane bounds, such as a state that is not finite",
    "igd_plus": "mean distance by which the front falls short of the reference front; 0 is best",
    "episode_length": "mean episode length in control steps",
}


def report(
    title: str,
    verdict: str,
    about: str,
    command: str,
    evaluations: Mapping[str, Evaluated],
    summary: Mapping[str, Quartiles],
    fronts: Mapping[str, Figure],
    figures: Sequence[tuple[str, Figure]],
    facts: Mapping[str, Mapping[str, str]],
    portrait: bytes | None = None,
) -> str:
    """Return the report as HTML, see `write`.

    Args:
        title: the task and its runs.
        verdict: how good the front is and what to do next.
        about: how they were evaluated, in a sentence or two.
        command: the command line of the evaluation.
        evaluations: by run name.
        summary: measure -> quartiles over runs; empty for a single run.
        fronts: figure of each run's front, by run name.
        figures: captions and figures of everything else.
        facts: run -> name -> text.
        portrait: picture of the robot as PNG (None: leave it out).
    """
    objectives = next(iter(evaluations.values())).front.objectives
    settings = dict.fromkeys(name for run in facts.values() for name in run)
    return rendered(
        "report.html",
        title=title,
        verdict=verdict,
        about=about,
        command=command,
        colors=dict(zip(objectives, of_objectives(len(objectives)), strict=True)),
        fronts={name: _front(run.front, fronts[name]) for name, run in evaluations.items()},
        # an <img> keeps the ids of one SVG apart from those of the others
        figures=[(name, data_url("svg+xml", svg(f).encode()), width(f)) for name, f in figures],
        runs=facts,
        settings=[[name, *(run.get(name, "") for run in facts.values())] for name in settings],
        portrait=portrait and data_url("png", portrait),
        configs={name: write_yaml(run.policy.config) for name, run in evaluations.items()},
        heads=["", *evaluations, *(("median", "quartiles") if summary else ()), ""],
        indicators=[
            [words(name), *_numbers(name, evaluations, summary), meaning(name)]
            for name in next(iter(evaluations.values())).measures
        ],
    )


@cache
def _templates() -> Environment:
    folder = PackageLoader(str(__package__), "")
    return Environment(
        loader=folder,
        autoescape=lambda name: name is not None and name.endswith(".html"),
        trim_blocks=True,
        undefined=StrictUndefined,
    )


def rendered(template: str, **values: Any) -> str:
    """Return a template of this folder with these values; texts are escaped."""
    return _templates().get_template(template).render(values)


def data_url(kind: str, content: bytes) -> str:
    """Return a picture as an address that holds all of it."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def number(value: float) -> str:
    return f"{value:,.4g}"


def words(measure: str) -> str:
    return "IGD+" if measure == "igd_plus" else measure.replace("_", " ")


def meaning(measure: str) -> str:
    """Return a short explanation of a measure, empty if there is none."""
    ends = {"_min": "lowest return of any policy", "_max": "highest return of any policy"}
    return MEANINGS.get(measure) or ends.get(measure[-4:], "")


def width(figure: Figure) -> str:
    """Return the width in pixels at which a figure's text has its own size."""
    return f"{96 * figure.get_figwidth():.0f}"


def _front(front: Front, figure: Figure) -> dict[str, Any]:
    """Return a front that a user can point at, and the table of its representative policies."""
    heads = [*(f"weight of {name}" for name in front.objectives)]
    heads += [*(f"{name} (return)" for name in front.objectives), *front.quantity_names]
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)
    columns = [front.returns]
    if front.quantities is not None:
        columns = [*columns, front.quantities]
    if front.falls is not None:
        heads, columns = [*heads, "fall rate"], [*columns, front.falls[:, None]]
    rows = [
        [
            name,
            *(f"{share:.2f}" for share in shares[index]),
            *(number(value) for column in columns for value in column[index]),
        ]
        for index, name in representatives(front).items()
    ]
    drawing = chart(figure, front)
    return {"drawing": drawing, "width": width(figure), "heads": ["policy", *heads], "rows": rows}


def _numbers(
    measure: str, evaluations: Mapping[str, Evaluated], summary: Mapping[str, Quartiles]
) -> list[str]:
    """Return the measure of each run, and its median and quartiles over several."""
    numbers = [number(run.measures[measure]) for run in evaluations.values()]
    if not summary:
        return numbers
    low, median, high = summary[measure]
    return [*numbers, number(median), f"{number(low)} - {number(high)}"]


def chart(figure: Figure, front: Front) -> str:
    """Return a figure of a front as SVG for HTML. page.js shows the policy a user points at."""
    best = front.non_dominated
    shown = {NON_DOMINATED: np.flatnonzero(best), "dominated": np.flatnonzero(~best)}
    for axes in figure.axes:
        for points in axes.collections:
            if (indices := shown.get(str(points.get_label()))) is not None and axes.name != "3d":
                points.set_urls([f"#{index}" for index in indices])
    texts = descriptions(front)
    drawn = re.sub(
        r'<a xlink:href="#(\d+)" target="_blank">',
        lambda link: f'<a href="#{link[1]}"><title>{escape(texts[int(link[1])])}</title>',
        svg(figure),
    )
    # HTML needs no namespaces, and the metadata names websites
    return re.sub(
        r"<metadata>.*?</metadata>|^.*?(?=<svg)| xmlns(:\w+)?=\"[^\"]*\"", "", drawn, flags=re.S
    )


def svg(figure: Figure) -> str:
    drawn = io.BytesIO()
    with mpl.rc_context(FILES):
        figure.savefig(drawn, format="svg", metadata={"Date": None})
    return drawn.getvalue().decode()


def descriptions(front: Front) -> list[str]:
    """Return the trade-off, the returns and the measured quantities of every policy, as text."""
    shares = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True)

    def named(names: tuple[str, ...], values: np.ndarray, form: str) -> str:
        pairs = zip(names, values.tolist(), strict=True)
        return ", ".join(f"{name} {value:{form}}" for name, value in pairs)

    texts = []
    for k in range(len(shares)):
        text = f"weights: {named(front.objectives, shares[k], '.2f')}"
        text += f"; returns: {named(front.objectives, front.returns[k], ',.4g')}"
        if front.quantities is not None:
            text += f"; {named(front.quantity_names, front.quantities[k], ',.4g')}"
        texts.append(text)
    return texts
