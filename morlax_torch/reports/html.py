"""Parts of self-contained HTML files: a document, rows of tables, facts, and pictures."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources

NARROW = 16  # characters that fit into a column of facts


def document(title: str, parts: Sequence[str], script: str = "") -> str:
    """Return a document with the style of reports; `script` is run at its end."""
    style = (resources.files(str(__package__)) / "page.css").read_text()
    ending = f"\n<script>\n{script}</script>" if script else ""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + f"{ending}\n</body>\n</html>\n"
    )


def number(value: float) -> str:
    return f"{value:,.4g}"


def row(tag: str, cells: Sequence[str]) -> str:
    """Return a row of a table: cells of numbers, and a last one of words."""
    *numbers, meaning = (escape(cell) for cell in cells)
    inner = "".join(f"<{tag}>{cell}</{tag}>" for cell in numbers)
    return f'<tr>{inner}<td class="words">{meaning}</td></tr>\n'


def table(rows: Sequence[str], kind: str = "") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'<div class="scroll"><table{style}>{"".join(rows)}</table></div>'


def facts(known: Mapping[str, str]) -> str:
    """Return names and short texts as a list."""
    items = ""
    for name, text in known.items():
        wide = ' class="wide"' if len(text) > NARROW else ""
        items += f"<div{wide}><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>"
    return f"<dl>{items}</dl>"


def image(about: str, kind: str, content: bytes) -> str:
    data = base64.b64encode(content).decode()
    return f'<img alt="{escape(about)}" src="data:image/{kind};base64,{data}">'


def scrolled(about: str, kind: str, content: bytes) -> str:
    """Return an image that a narrow page scrolls; figures set `--natural`, its width."""
    return f'<div class="scroll">{image(about, kind, content)}</div>'
