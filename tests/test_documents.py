"""What the README and the pages of docs/ show can be done as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from morlax_torch import MORLAX, checkpoint
from morlax_torch.config import Config, file_values, load_config, merged, task_values
from morlax_torch.evaluation import Front
from morlax_torch.train import make_worlds

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(language: str) -> list:
    """Every block of code in a language, as a parameter that says which page it is from."""
    return [
        pytest.param(block, id=f"{page.stem}-{number}")
        for page in PAGES
        for number, block in enumerate(
            re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)
        )
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    config: Config = load_config(merged(task_values("cheetah", "cpu"), {"worlds": 32}))
    (folder / "checkpoints").mkdir()
    morlax = MORLAX(make_worlds(config, 32), config)
    checkpoint.save(folder / "checkpoints" / "best.pt", morlax, {})
    shares = np.linspace(0, 1, 5)
    tradeoffs = np.stack([shares, 1 - shares], 1)
    front = Front(("run", "energy"), tradeoffs, tradeoffs, np.full(5, 500), np.zeros(2))
    front.save(folder / "front.npz")
    return folder


@pytest.mark.parametrize("code", blocks("python"))
def test_python_runs(code, run, tmp_path, monkeypatch):
    for module in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE):
        pytest.importorskip(module, reason=f"{module} is not installed")
    monkeypatch.chdir(tmp_path)
    exec(re.sub(r"runs/cheetah/[\d-]+", str(run), code), {})


@pytest.mark.parametrize("text", blocks("yaml"))
def test_configs_load(text, tmp_path):
    (tmp_path / "my.yaml").write_text(text)
    config = load_config(file_values(tmp_path / "my.yaml", "cpu"))
    assert list(config.task.objectives) == list(yaml.safe_load(text)["task"]["objectives"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_linked_files_exist(page):
    for link in re.findall(r"\]\(([\w./-]+)\)", page.read_text()):
        assert (page.parent / link).exists(), link
