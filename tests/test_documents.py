"""The code, configs and links of the README and docs/ work as printed."""

import inspect
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
import yaml

import morlax_torch
from morlax_torch import MORLAX, config_for, envs
from morlax_torch.commands import export
from morlax_torch.configuration.config import Config, load_config
from morlax_torch.configuration.files import file_values, merged, space_values, task_values
from morlax_torch.runs import checkpoint
from morlax_torch.runs.evaluating import evaluate
from morlax_torch.runs.loading import load
from morlax_torch.runs.progress import Progress

ROOT = Path(__file__).parent.parent
A_RUN = re.compile(r"runs/cheetah\b")  # names the newest run
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FRESH_ONLY = ("export", "integrations")  # pages whose code only runs in fresh processes
NOTES = sorted((ROOT / "benchmarks").rglob("*.md"))
LINK = re.compile(r"\]\(([\w./-]*)(?:#([\w-]+))?\)")


def blocks(language: str) -> list:
    """Return every code block of a language as a test parameter named after its page.

    The tutorial's blocks need each other: test_tutorial.py runs them.
    """
    return [
        pytest.param(block, id=f"{page.stem}-{number}")
        for page in PAGES
        if page.stem != "tutorial"
        for number, block in enumerate(
            re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)
        )
    ]


def only_in_a_fresh_process(block) -> bool:
    """Say whether a block is slow, or starts processes that import the block itself."""
    (code,), page = block.values, block.id.rpartition("-")[0]
    return page in FRESH_ONLY or "tuning.searching" in code


def _marked(every: list) -> list:
    """Mark as long the blocks that `test_python_runs` runs, too, in less time."""
    long = pytest.mark.long
    return [
        block
        if only_in_a_fresh_process(block)
        else pytest.param(*block.values, id=block.id, marks=long)
        for block in every
    ]


@pytest.fixture
def workplace(tmp_path, monkeypatch) -> Path:
    """Return a folder with the files that pages show; each starts with a comment naming it."""
    file = re.compile(r"```\w+\n((?:# |<!-- )([\w.]+\.\w+)\b.*?)```", re.DOTALL)
    for page in PAGES:
        for text, name in file.findall(page.read_text()):
            (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    config: Config = load_config(merged(task_values("cheetah", "cpu"), {"worlds": 32}))
    (folder / "checkpoints").mkdir()
    morlax = MORLAX(config.make_worlds(32, config.seed), config)
    checkpoint.save(folder / "checkpoints" / "best.pt", morlax, Progress())
    evaluate(load(folder), tradeoffs=5, device="cpu").save(folder / "front.npz")
    return folder


@pytest.fixture(scope="module")
def exported(run, tmp_path_factory) -> Path:
    """Return a folder where the commands of the export page have run."""
    pytest.importorskip("onnxruntime")
    folder = tmp_path_factory.mktemp("exported")
    page = (ROOT / "docs" / "export.md").read_text()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in re.findall(r"^morlax export (runs/cheetah.*)", page, re.MULTILINE):
            export.command(shlex.split(A_RUN.sub(str(run), line)))
    return folder


def with_short_episodes(task: str, **changes) -> Config:
    """`config_for`, so that evaluations take less time."""
    length = {} if ":" in task else {"task.episode_length": 20}
    return config_for(task, **{**length, **changes})


ALONE = """
import builtins
usual = builtins.__import__
def importing(name, *others, **named):
    module = usual(name, *others, **named)
    if name.partition(".")[0] == "morlax_torch":
        builtins.__import__ = usual
        import morlax_torch
        given = morlax_torch.config_for
        morlax_torch.config_for = lambda env, **changes: given(
            env, **{**({} if ":" in env else {"task.episode_length": 20}), **changes}
        )
    return module
builtins.__import__ = importing
"""  # with short episodes, as soon as a block imports morlax_torch


@pytest.mark.slow
@pytest.mark.parametrize("code", _marked(blocks("python")))
def test_python_runs_in_a_fresh_process(code, run, workplace, request):
    """No block uses names, imports or filters of warnings of another one."""
    for module in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE):
        pytest.importorskip(module, reason=f"{module} is not installed")
    if "import wandb" in code:
        pytest.skip("test_hosts.py starts it")
    if "import record" in code:
        request.getfixturevalue("opengl")
    exports = "export-" in request.node.callspec.id
    folder = request.getfixturevalue("exported") if exports else workplace
    code = ALONE + A_RUN.sub(str(run), code)
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "code", [block for block in blocks("python") if not only_in_a_fresh_process(block)]
)
def test_python_runs(code, run, workplace, monkeypatch, request):
    for module in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE):
        pytest.importorskip(module, reason=f"{module} is not installed")
    if "import record" in code:
        request.getfixturevalue("opengl")
    # a task that one page registers must not exist on the next
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
    monkeypatch.setattr(morlax_torch, "config_for", with_short_episodes)
    code = A_RUN.sub(str(run), code)
    if "import wandb" in code:  # test_hosts.py starts it
        import wandb

        signature = inspect.signature(wandb.init)
        monkeypatch.setattr(wandb, "init", lambda **o: nullcontext(signature.bind(**o)))
    exec(code, {})


def commands_of_shown_scripts() -> list[tuple[str, str]]:
    """Return (script, command line) where a page shows the script and how to run it."""
    found = []
    for text in (page.read_text() for page in PAGES):
        shown = set(re.findall(r"^```python\n# (\w+\.py)\n", text, re.MULTILINE))
        lines = re.findall(r"^python ((\w+\.py).*)", text, re.MULTILINE)
        found += [(script, line) for line, script in lines if script in shown]
    return found


@pytest.mark.parametrize(("script", "line"), commands_of_shown_scripts())
@pytest.mark.slow
def test_shown_scripts_run(script, line, workplace, monkeypatch):
    for module in re.findall(r"^(?:import|from) (\w+)", Path(script).read_text(), re.MULTILINE):
        pytest.importorskip(module, reason=f"{module} is not installed")
    monkeypatch.setattr(sys, "argv", shlex.split(line))
    runpy.run_path(script, run_name="__main__")
    assert any(workplace.rglob("front.npz"))


def test_the_shown_search_space_is_valid(workplace):
    pytest.importorskip("optuna", reason="needs the extra tune")
    from morlax_torch.tuning.study import Space

    for device_type in ("cpu", "cuda"):
        config = load_config(task_values("cheetah", device_type))
        assert Space(space_values(Path("my_space.yaml"), device_type), config, "").distributions


CONFIGS = [block for block in blocks("yaml") if not block.values[0].startswith("# my_space.yaml")]


@pytest.mark.parametrize("text", CONFIGS)
def test_configs_load(text, workplace):
    if "mjlab:" in text:
        pytest.importorskip("mjlab", reason="needs the extra mjlab")
    (workplace / "my.yaml").write_text(text)
    given = yaml.safe_load(text)
    for device_type in ("cpu", "cuda"):
        config = load_config(file_values(workplace / "my.yaml", device_type))
        assert config.env.endswith(given["env"])
        if "task" in given:
            assert list(config.task.objectives) == list(given["task"]["objectives"])


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *NOTES], ids=str
)
def test_links_lead_somewhere(page):
    for link, anchor in LINK.findall(page.read_text()):
        target = page.parent / link if link else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), f"{link}#{anchor}"


def test_the_docs_stay_short():
    pages = [*PAGES, ROOT / "CONTRIBUTING.md"]
    assert len(pages) <= 20
    assert sum(len(page.read_text().split()) for page in pages) <= 28_000
