"""SVG and HTML elements as strings; lengths are in units of the drawing."""

from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

GRAY, INK = "#9aa3ad", "currentColor"  # readable on light and on dark pages


class Box(NamedTuple):
    """A rectangle."""

    left: float
    top: float
    width: float
    height: float


def element(name: str, content: str = "", **attributes: Any) -> str:
    """Return an element; underscores in attribute names become hyphens."""
    written = []
    for key, value in attributes.items():
        text = f"{value:.2f}" if isinstance(value, float | np.floating) else escape(str(value))
        written.append(f'{key.replace("_", "-")}="{text}"')
    return f"<{name} {' '.join(written)}>{content}</{name}>"


def circle(center: ArrayLike, r: float, fill: str, content: str = "", **attributes: Any) -> str:
    """Return a disk of radius `r` around `center` (2,); `content` may hold its <title>."""
    x, y = np.asarray(center, dtype=float)
    return element("circle", content, cx=x, cy=y, r=r, fill=fill, **attributes)


def text(content: str, x: float, y: float, fill: str, anchor: str = "middle", **more: Any) -> str:
    """Return one line of text; `anchor` is its start, middle or end."""
    return element("text", escape(content), x=x, y=y, fill=fill, text_anchor=anchor, **more)
