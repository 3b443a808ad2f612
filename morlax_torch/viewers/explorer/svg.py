"""The few words of SVG and HTML that drawings are made of, in units of the drawing."""

from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Box(NamedTuple):
    """A rectangle."""

    left: float
    top: float
    width: float
    height: float


def element(name: str, content: str = "", **attributes: Any) -> str:
    """An element; an underscore in an attribute's name stands for a hyphen."""
    written = []
    for key, value in attributes.items():
        text = f"{value:.2f}" if isinstance(value, float | np.floating) else escape(str(value))
        written.append(f'{key.replace("_", "-")}="{text}"')
    return f"<{name} {' '.join(written)}>{content}</{name}>"


def circle(centre: ArrayLike, r: float, fill: str, **attributes: Any) -> str:
    """A disc around (2,)."""
    x, y = np.asarray(centre, dtype=float)
    return element("circle", cx=x, cy=y, r=r, fill=fill, **attributes)


def text(content: str, x: float, y: float, fill: str, anchor: str = "middle", **more: Any) -> str:
    """One line, placed by its middle, start or end."""
    return element("text", escape(content), x=x, y=y, fill=fill, text_anchor=anchor, **more)
