"""HTML reports and their parts; each is one self-contained file from a template of this folder."""

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

from ..evaluation.front import Front, representatives
from ..evaluation.requirements import Choice
from ..evaluation.style import FILES, NON_DOMINATED
from ..runs.choosing import CONDITIONS, Trial


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
    templates.filters |= {"number": number, "words": words}
    return templates


def rendered(template: str, **values: Any) -> str:
    return _templates().get_template(template).render(values)


def data_url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def width(figure: Figure) -> str:
    """Return the width in pixels at which a figure's text has its own size."""
    return f"{96 * figure.get_figwidth():.0f}"


def front_part(front: Front, figure: Figure) -> dict[str, Any]:
    """Return a front that a user can point at, and the table of its representative policies."""
    heads = ["policy", *(f"weight of {name}" for name in front.objectives)]
    heads += [*(f"{name} (return)" for name in front.objectives), *front.quantity_names]
    shares, values = front.tradeoffs / front.tradeoffs.sum(1, keepdims=True), front.values
    if front.falls is not None:
        heads, values = [*heads, "fall rate"], np.column_stack([values, front.falls])
    rows = [
        [name, *(f"{share:.2f}" for share in shares[index]), *map(number, values[index])]
        for index, name in representatives(front).items()
    ]
    return {"drawing": chart(figure, front), "width": width(figure), "heads": heads, "rows": rows}


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
    names = front.objectives + front.quantity_names
    texts = []
    for weights, values in zip(shares.tolist(), front.values.tolist(), strict=True):
        weighed = [f"{n} {w:.2f}" for n, w in zip(front.objectives, weights, strict=True)]
        measured = [f"{n} {v:,.4g}" for n, v in zip(names, values, strict=True)]
        texts.append(f"weights: {', '.join(weighed)}; returns: {', '.join(measured)}")
    return texts


def card(
    task: str,
    choice: Choice,
    trials: Mapping[str, Trial],
    origin: Mapping[str, str],
    commands: Sequence[str],
    strip: bytes | None = None,
) -> str:
    """Return the decision card: why a trade-off was chosen, and what its policy does.

    `trials` are the choice under other conditions, and `origin` texts such as the checkpoint, both
    by name. `commands` are command lines that use the choice, `strip` is a film strip as PNG.
    """
    required = choice.required
    # a fall breaks every requirement
    missed = [
        name
        for name, trial in trials.items()
        if trial.falls or not required.kept(trial.values[None])[0]
    ]
    return rendered(
        "card.html",
        task=task,
        choice=choice,
        maximized=required.names[required.maximized],
        strip=strip and data_url("png", strip),
        trials=trials,
        missed=missed,
        conditions=CONDITIONS,
        origin=origin,
        commands=commands,
    )
