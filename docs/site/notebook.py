"""Make a notebook of a page: `python docs/site/notebook.py` writes docs/tutorial.ipynb.

Text becomes Markdown cells. Python blocks become cells of code, shell blocks cells of `!` commands,
and blocks that start with a comment naming a file, cells that write it. Colab opens the notebook on
a GPU, and the first cell installs the package there.
"""

import argparse
import json
import re
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```(python|xml|sh)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
INSTALL = re.compile(r"`pip install '\.\[(.*?)\]'`")  # from a checkout
FILE = re.compile(r"(?:# |<!-- )([\w.]+\.\w+)(?: -->)?\n")


class Cell(NamedTuple):
    """A cell of a notebook."""

    kind: str  # markdown or code
    text: str


def cells(page: str) -> list[Cell]:
    """Split the text of a page into cells."""
    found, position = [_install(extras) for extras in INSTALL.findall(page)[:1]], 0
    for block in BLOCK.finditer(page):
        found += [Cell("markdown", page[position : block.start()]), _code(block[1], block[2])]
        position = block.end()
    found.append(Cell("markdown", page[position:]))
    return [Cell(kind, text.strip("\n")) for kind, text in found if text.strip()]


def _install(extras: str) -> Cell:
    reason = "# for Colab; changes nothing where the package is installed"
    return Cell("code", f"%pip install --quiet 'morlax-torch[{extras}]'\n{reason}")


def _code(language: str, text: str) -> Cell:
    file = FILE.match(text)
    if file:
        return Cell("code", f"%%writefile {file[1]}\n{text}")
    if language == "sh":
        text = "".join(f"!{line}\n" for line in text.splitlines())
    return Cell("code", text)


def notebook(page: str) -> str:
    """Return the notebook of a page, as JSON."""
    described = []
    for number, cell in enumerate(cells(page)):
        code = {"execution_count": None, "outputs": []} if cell.kind == "code" else {}
        described.append(
            {
                "cell_type": cell.kind,
                "id": f"cell-{number}",
                "metadata": {},
                "source": cell.text.splitlines(keepends=True),
                **code,
            }
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    colab = {"accelerator": "GPU", "colab": {"gpuType": "T4", "provenance": []}}
    content = {
        "cells": described,
        "metadata": {**colab, "kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    (DOCS / "tutorial.ipynb").write_text(notebook((DOCS / "tutorial.md").read_text()))
