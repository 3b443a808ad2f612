"""What the README shows can be done as it stands there."""

import re
from pathlib import Path

import pytest
import yaml

from morlax_torch import MORLAX, checkpoint
from morlax_torch.config import Config, file_values, load_config, merged, task_values
from morlax_torch.train import make_worlds

README = (Path(__file__).parent.parent / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    config: Config = load_config(merged(task_values("cheetah", "cpu"), {"worlds": 32}))
    (folder / "checkpoints").mkdir()
    morlax = MORLAX(make_worlds(config, 32), config)
    checkpoint.save(folder / "checkpoints" / "best.pt", morlax, {})
    return folder


@pytest.mark.parametrize("code", blocks("python"))
def test_python_runs(code, run):
    exec(re.sub(r"runs/cheetah/[\d-]+", str(run), code), {})


@pytest.mark.parametrize("text", blocks("yaml"))
def test_configs_load(text, tmp_path):
    (tmp_path / "my.yaml").write_text(text)
    config = load_config(file_values(tmp_path / "my.yaml", "cpu"))
    assert list(config.task.objectives) == list(yaml.safe_load(text)["task"]["objectives"])


def test_linked_files_exist():
    root = Path(__file__).parent.parent
    for link in re.findall(r"\]\(([\w./-]+)\)", README):
        assert (root / link).exists(), link
