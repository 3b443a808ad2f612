"""What README and docs show can be done as it stands there."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from morlax_torch import MORLAX, checkpoint, envs, export
from morlax_torch.config import Config, file_values, load_config, merged, task_values
from morlax_torch.evaluate import evaluate
from morlax_torch.policy import load
from morlax_torch.train import make_worlds

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "docs/evaluation.md", "docs/export.md", "docs/your-own-network.md")
A_RUN = re.compile(r"runs/cheetah/[\d-]+")


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def all_blocks(language: str) -> list:
    return [
        pytest.param(page, text, id=f"{page}-{number}")
        for page in PAGES
        for number, text in enumerate(blocks(page, language))
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    config: Config = load_config(merged(task_values("cheetah", "cpu"), {"worlds": 32}))
    (folder / "checkpoints").mkdir()
    morlax = MORLAX(make_worlds(config, 32), config)
    checkpoint.save(folder / "checkpoints" / "best.pt", morlax, {})
    evaluate(load(folder), tradeoffs=4, device="cpu").save(folder / "front.npz")
    return folder


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory) -> Path:
    """Where the page on exports has done what its command lines say."""
    folder = tmp_path_factory.mktemp("exported")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in "".join(blocks("docs/export.md", "sh")).splitlines():
            if line.startswith("python -m morlax_torch.export"):
                export.command(shlex.split(A_RUN.sub(str(run), line))[3:])
    return folder


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*treespec:FutureWarning")
@pytest.mark.parametrize(("page", "code"), all_blocks("python"))
def test_python_runs(page, code, run, tmp_path, monkeypatch, request):
    monkeypatch.setattr(envs, "_REGISTRY", dict(envs._REGISTRY))  # what pages register stays here
    exports = page == "docs/export.md"
    monkeypatch.chdir(request.getfixturevalue("exported") if exports else tmp_path)
    exec(A_RUN.sub(str(run), code), {})


@pytest.mark.parametrize(("page", "text"), all_blocks("yaml"))
def test_configs_load(page, text, tmp_path):
    (tmp_path / "my.yaml").write_text(text)
    config = load_config(file_values(tmp_path / "my.yaml", "cpu"))
    assert list(config.task.objectives) == list(yaml.safe_load(text)["task"]["objectives"])


@pytest.mark.parametrize("page", PAGES)
def test_linked_files_exist(page):
    path = ROOT / page
    for link in re.findall(r"\]\(([\w./-]+)\)", path.read_text()):
        assert (path.parent / link).exists(), link
