"""The code, configs, links and commands of the README and docs/ work as printed."""

import inspect
import re
import shlex
import sys
import warnings
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from programs import Program

import morlax_torch
from morlax_torch import config_for
from morlax_torch.__main__ import COMMANDS, command
from morlax_torch.commands import export, train
from morlax_torch.configuration.config import Config, load_config
from morlax_torch.configuration.files import file_values

ROOT = Path(__file__).parents[2]
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
    return block.id.rpartition("-")[0] in FRESH_ONLY


@pytest.fixture
def workplace(tmp_path, monkeypatch, make_run) -> Path:
    """Return a folder with a run, and the files that pages show below a comment with their name."""
    file = re.compile(r"```\w+\n((?:# |<!-- )([\w.]+\.\w+)\b.*?)```", re.DOTALL)
    for page in PAGES:
        for text, name in file.findall(page.read_text()):
            (tmp_path / name).write_text(text)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    make_run(tmp_path / "run", "cheetah", "best")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def run(tmp_path_factory, make_run) -> Path:
    return make_run(tmp_path_factory.mktemp("runs") / "run", "cheetah", "best")


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


def needs_modules(code: str) -> None:
    for module in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE):
        pytest.importorskip(module, reason=f"{module} is not installed")
    if "from mjlab.tasks" in code:  # which uses what torch deprecates
        with warnings.catch_warnings(action="ignore"):
            import_module("mjlab.tasks")


def stand_in_for_trackers(monkeypatch) -> set[str]:
    """Replace MLflow 3 and Trackio 0.43 by what pages call of them, and return what is logged."""
    logged: set[str] = set()

    def log(metrics, step=None):
        assert all(type(value) in (int, float) for value in metrics.values()) and step >= 0
        logged.update(metrics)

    def configure(config, project="hopper"):
        assert config["env"] == project

    mlflow = {"start_run": nullcontext, "log_params": configure, "log_metrics": log}
    trackio = {"init": configure, "log": log, "finish": lambda: None}
    monkeypatch.setitem(sys.modules, "mlflow", SimpleNamespace(**mlflow))
    monkeypatch.setitem(sys.modules, "trackio", SimpleNamespace(**trackio))
    return logged


@pytest.mark.slow
@pytest.mark.parametrize("code", [x for x in blocks("python") if only_in_a_fresh_process(x)])
def test_python_runs_in_a_fresh_process(code, run, workplace, request):
    needs_modules(code)
    exports = "export-" in request.node.callspec.id
    folder = request.getfixturevalue("exported") if exports else workplace
    status, _, errors = Program(A_RUN.sub(str(run), code), folder).ended()
    assert status == 0, errors


@pytest.mark.parametrize(
    "code", [block for block in blocks("python") if not only_in_a_fresh_process(block)]
)
def test_python_runs(code, run, workplace, monkeypatch, request):
    logged = stand_in_for_trackers(monkeypatch)
    needs_modules(code)
    if "import record" in code:
        request.getfixturevalue("opengl")
    monkeypatch.setattr(morlax_torch, "config_for", with_short_episodes)
    code = A_RUN.sub(str(run), code)
    if "import wandb" in code:  # test_hosts.py starts it
        import wandb

        signature = inspect.signature(wandb.init)
        monkeypatch.setattr(wandb, "init", lambda **o: nullcontext(signature.bind(**o)))
    exec(code, {})
    assert ("front/hypervolume" in logged) == ("on_metrics=" in code)


@pytest.mark.parametrize("text", blocks("yaml"))
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


OURS = re.compile(rf"(?:python -m morlax_torch\.|morlax )(?:{'|'.join(COMMANDS)}) +(?!\.\.\.)")
SHORT = (
    *("--device", "cpu", "--worlds", "16", "--horizon", "4", "--sampling.clusters", "8"),
    *("--ppo.minibatches", "1", "--evaluation.tradeoffs", "8", "--task.episode-length", "20"),
    *("--max-env-steps", "64", "--output", "short"),
)
NOT_RUN = {  # part of a command line: why no test runs it
    "morlax new": "needs the MJCF of a robot; test_new.py has some",
    "pip install": "needs a network; .ci/run installs the package",
    "pip uninstall": "removes what the tests need",
    "apt-get": "needs root",
    **dict.fromkeys(("nvidia-smi", "torch.cuda.init()"), "needs a GPU"),
    "ssh ": "needs another machine",
    **dict.fromkeys(("srun ", "scontrol ", "#!", "#SBATCH", "--rdzv-id"), "needs Slurm"),
    "torchrun ": "test_torchrun.py starts such processes",
    "-m morlax_torch.train --env humanoid --output /shared/humanoid": "test_torchrun.py does",
    "python benchmarks/": "takes minutes to hours; test_compare.py imports some",
    "python docs/examples/": "test_examples.py does",
    "morlax export runs/cheetah": "test_documents.py and test_export.py do",
    **dict.fromkeys(("morlax export go1", "morlax export g1"), "test_mjlab_play.py does"),
    "morlax choose g1": "needs mjlab; test_mjlab.py chooses",
    "morlax play": "needs the export of a task of mjlab; test_mjlab_play.py has one",
    "Pareto-Velocity": "needs mjlab; test_pareto_mjlab.py trains and plays it",
    "morlax_torch.rsl_rl:ParetoPPO": "test_pareto_mjlab.py does",
    "morlax explore logs/rsl_rl": "needs mjlab; test_pareto_mjlab.py loads such a folder",
    "python -m pytest": "starts the tests",
    "--over-time": "takes a minute; test_over_time.py searches with less",
    "tradeoff_over_time.yaml": "needs the result of a search; test_over_time.py films one",
    "morlax design": "needs a run with designs; test_designs.py searches one",
    "morlax explore": "a server; .ci/smoke.py starts it",
    "runs/go1": "needs mjlab; test_mjlab.py trains",
    "runs/jazz": "needs mjlab; test_tracking.py trains",
    "mjlab:": "needs older simulators; test_mjlab.py trains",
    "gymnasium:mo-": "needs mo-gymnasium; test_gymnasium_worlds.py trains",
    "MUJOCO_GL=osmesa": "needs OSMesa",
    "http.server": "serves until it is stopped; test_web_page.py serves such a page",
    "morlax pack": "needs a finished run; .ci/smoke.py packs one",
}
NAMED = {  # names that stand for a user's own
    "my_robot.py:MyRobot": "crawler.py:Crawler",
    r"runs/[\w-]+(?:/\*)?": "run",
    r"\blatest\b": "run",
    "docs/examples/": f"{ROOT}/docs/examples/",
}


def printed() -> list:
    """Return the lines of every shell block, and our commands with options within text."""
    found = {}
    for page in [*PAGES, ROOT / "CONTRIBUTING.md"]:
        text = page.read_text()
        blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        lines = "".join(blocks).replace("\\\n", " ").splitlines()
        lines += [code for code in re.findall(r"`([^`\n]+)`", text) if OURS.match(code)]
        for line in lines:
            for part in line.partition("  # ")[0].split(" && "):
                if part.strip():
                    found.setdefault(" ".join(part.split()), page.stem)
    return [pytest.param(line, id=f"{page}: {line}") for line, page in found.items()]


RUNNABLE = [case for case in printed() if not any(part in case.values[0] for part in NOT_RUN)]


def words(line: str) -> list[str]:
    """Return the command's name and arguments, with names that stand for others replaced."""
    assert OURS.match(line), "no test knows how to run it: add it to NOT_RUN, with a reason"
    for name, other in NAMED.items():
        line = re.sub(name, other, line)
    name, *arguments = shlex.split(line.removeprefix("python -m morlax_torch."))
    return arguments if name == "morlax" else [name, *arguments]


def without(arguments: list[str], *options: str) -> list[str]:
    for option in options:
        if option in arguments:
            place = arguments.index(option)
            arguments = arguments[:place] + arguments[place + 2 :]
    return arguments


def on_the_cpu(arguments: list[str]) -> list[str]:
    """Return the arguments with another device, since tests may have no GPU."""
    return [*without(arguments, "--device"), "--device", "cpu"]


@pytest.mark.parametrize("line", RUNNABLE)
def test_a_printed_command_is_valid(line, workplace, request):
    name, *arguments = words(line)
    if name == "train":
        train.read(on_the_cpu(arguments))
        return
    if name == "record":
        pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
        request.getfixturevalue("opengl")
        arguments += ["--seconds", "0.1", "--width", "64", "--height", "64"]
    if name == "export":
        pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    if name == "evaluate":
        arguments += ["--device", "cpu", "--tradeoffs", "4"]
    command([name, *arguments])


@pytest.mark.slow
@pytest.mark.parametrize("line", [case for case in RUNNABLE if words(case.values[0])[0] == "train"])
def test_a_printed_training_runs(line, workplace):
    name, *arguments = words(line)
    arguments = without(on_the_cpu(arguments), "--max-seconds", "--output")
    command([name, *arguments, *SHORT])
    assert (workplace / "short" / "front.npz").is_file()


def test_reasons_are_not_out_of_date():
    lines = [case.values[0] for case in printed()]
    for part in NOT_RUN:
        assert any(part in line for line in lines), f"no page prints {part}: delete its reason"


def test_the_docs_stay_short():
    pages = [*PAGES, ROOT / "CONTRIBUTING.md"]
    assert len(pages) <= 21
    assert sum(len(page.read_text().split()) for page in pages) <= 28_000
