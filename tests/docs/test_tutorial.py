"""The tutorial's code runs in its order, and its notebook is the same text."""

import json
import shlex
from pathlib import Path

import notebook
import pytest

from morlax_torch.__main__ import command

DOCS = Path(__file__).parents[2] / "docs"

LONG = "max_env_steps=300_000"
SHORT = 'max_env_steps=4_096, evaluation={"tradeoffs": 64}'
ENDLESS = "morlax explore"  # test_install.py and test_explore.py start it
WRITE = "%%writefile "
INSTALL = "%pip install --quiet 'morlax-torch["


def run_cells(cells: list[str]) -> dict:
    """Run cells of code as Jupyter would, and return their variables."""
    names: dict = {}
    for cell in cells:
        first, _, rest = cell.partition("\n")
        if first.startswith(WRITE):
            Path(first.removeprefix(WRITE)).write_text(rest)
        elif first.startswith(INSTALL):
            continue  # needs a network; .ci/run installs the package
        elif first.startswith("!"):
            for line in cell.splitlines():
                if not line[1:].startswith(ENDLESS):
                    program, *arguments = shlex.split(line[1:])
                    assert program == "morlax"
                    command(arguments)
        else:
            exec(cell, names)
    return names


@pytest.mark.slow
def test_the_notebook_runs(workplace):
    pytest.importorskip("onnxruntime")
    content = json.loads((DOCS / "tutorial.ipynb").read_text())
    code = ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == "code"]
    assert sum(LONG in cell for cell in code) == 1
    names = run_cells([cell.replace(LONG, SHORT) for cell in code])
    assert names["choice"].returns["steady"] >= 185
    for written in ("front.png", "runs/crane/report.html", "runs/crane/policy.onnx"):
        assert Path(written).is_file()


def test_the_notebook_is_the_page():
    page = (DOCS / "tutorial.md").read_text()
    stored = (DOCS / "tutorial.ipynb").read_text()
    assert notebook.notebook(page) == stored, "run python docs/site/notebook.py"
