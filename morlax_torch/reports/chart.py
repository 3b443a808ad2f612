"""A figure of a front as inline SVG, in which each point tells its policy."""

import io
import re
from html import escape

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ..evaluation.figures.style import FILES, NON_DOMINATED
from ..evaluation.front import Front

HINT = "Point at a policy, or focus one and press the arrow keys, to see its returns."


def chart(caption: str, figure: Figure, front: Front) -> str:
    """Return a figure of a front as HTML. page.js shows the policy that a user points at."""
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
    drawn = re.sub(
        r"<metadata>.*?</metadata>|^.*?(?=<svg)| xmlns(:\w+)?=\"[^\"]*\"", "", drawn, flags=re.S
    )
    width = f"{96 * figure.get_figwidth():.0f}px"
    return (
        f'<figure class="front" style="--natural:{width}"><div class="scroll">{drawn}</div>'
        f"<output>{HINT}</output><figcaption>{escape(caption)}</figcaption></figure>"
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

    found = []
    for k in range(len(shares)):
        text = f"weights: {named(front.objectives, shares[k], '.2f')}"
        text += f"; returns: {named(front.objectives, front.returns[k], ',.4g')}"
        if front.quantities is not None:
            text += f"; {named(front.quantity_names, front.quantities[k], ',.4g')}"
        found.append(text)
    return found
