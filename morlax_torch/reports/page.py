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


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader(str(__package__), ""),
        autoescape=lambda name: name is not None and name.endswith(".html"),
        trim_blocks=True,
        undefined=StrictUndefined,
    )


def rendered(template: str, **values: Any) -> str:
    return _templates().get_template(template).render(values)


def data_url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def number(value: float) -> str:
    return f"{value:,.4g}"


def words(measure: str) -> str:
    return "IGD+" if measure == "igd_plus" else measure.replace("_", " ")


def meaning(measure: str) -> str:
    ends = {"_min": "lowest return of any policy", "_max": "highest return of any policy"}
    return MEANINGS.get(measure) or ends.get(measure[-4:], "")


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

    def named(names: tuple[str, ...], values: np.ndarray, form: str) -> str:
        pairs = zip(names, values.tolist(), strict=True)
        return ", ".join(f"{name} {value:{form}}" for name, value in pairs)

    texts = []
    for index, weights in enumerate(shares):
        text = f"weights: {named(front.objectives, weights, '.2f')}"
        text += f"; returns: {named(front.objectives, front.returns[index], ',.4g')}"
        if front.quantities is not None:
            text += f"; {named(front.quantity_names, front.quantities[index], ',.4g')}"
        texts.append(text)
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
    required, names = choice.required, choice.required.names
    # a fall breaks every requirement
    kept = {
        name: trial.falls == 0 and bool(required.kept(trial.values[None])[0])
        for name, trial in trials.items()
    }
    return rendered(
        "card.html",
        task=task,
        limits=[(limit.sign, number(limit.level), names[limit.index]) for limit in required.limits],
        maximized=names[required.maximized],
        weights=[
            f"{name} {weight:.1%}"
            for name, weight in zip(choice.returns, choice.tradeoff, strict=True)
        ],
        strip=strip and data_url("png", strip),
        values=choice.rows(",.4g"),
        cost=number(choice.cost),
        most=number(choice.values[required.maximized] + choice.cost),
        simulated=choice.simulated,
        conditions=["condition", *(names[i] for i in required.used), "falls", "keeps all"],
        trials=[
            [
                name,
                *map(number, trial.values[required.used]),
                f"{trial.falls:.0%}",
                "yes" if kept[name] else "no",
            ]
            for name, trial in trials.items()
        ],
        episodes=max(trial.episodes for trial in trials.values()),
        left_out=[name for name in CONDITIONS if name not in trials],
        missed=[name for name in trials if not kept[name]],
        origin=origin,
        commands=commands,
    )
