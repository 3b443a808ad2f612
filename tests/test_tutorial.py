"""The tutorial's code runs in its order, and its notebook is the same text."""

import json
import shlex
import tomllib
from pathlib import Path

import notebook
import pages
import pytest

from morlax_torch import envs
from morlax_torch.__main__ import command

DOCS = Path(__file__).parents[1] / "docs"

LONG = "max_env_steps=300_000"
SHORT = 'max_env_steps=4_096, evaluation={"tradeoffs": 64}'
ENDLESS = "morlax explore"  # test_install.py and test_explore.py start it
WRITE = "%%writefile "
INSTALL = "%pip install --quiet 'morlax-torch["


def run_command(line: str) -> None:
    program, *arguments = shlex.split(line)
    assert program == "morlax"
    command(arguments)


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
                    run_command(line[1:])
        else:
            exec(cell, names)
    return names


@pytest.mark.slow
def test_the_notebook_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
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


def test_colab_installs_the_package_and_lends_a_gpu():
    content = json.loads((DOCS / "tutorial.ipynb").read_text())
    install = "".join(content["cells"][0]["source"])
    assert install.startswith(INSTALL)
    extras = set(install.partition("[")[2].partition("]")[0].split(","))
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text())["project"]
    assert extras <= set(project["optional-dependencies"])
    assert content["metadata"]["accelerator"] == "GPU"
    assert content["metadata"]["colab"] == {"gpuType": "T4", "provenance": []}


def test_the_site_links_to_colab_if_the_repository_is_on_github():
    page = DOCS / "tutorial.md"
    link = "https://colab.research.google.com/github/name/repo/blob/main/docs/tutorial.ipynb"
    assert f"]({link})" in pages.rendered(page, "https://github.com/name/repo")
    for elsewhere in (None, "https://gitlab.com/name/repo"):
        assert "colab" not in pages.rendered(page, elsewhere)
