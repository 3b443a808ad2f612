"""Each command on the pages works as printed, or has a reason why no test runs it."""

import re
import shlex
from pathlib import Path

import pytest

from morlax_torch.__main__ import COMMANDS, command
from morlax_torch.commands import train, tune

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
OURS = re.compile(rf"(?:python -m morlax_torch\.|morlax )(?:{'|'.join(COMMANDS)}) +(?!\.\.\.)")
SHORT = (
    *("--device", "cpu", "--worlds", "16", "--horizon", "4", "--sampling.clusters", "8"),
    *("--ppo.minibatches", "1", "--evaluation.tradeoffs", "8", "--task.episode-length", "20"),
    *("--max-env-steps", "64", "--output", "short"),
)
NOT_RUN = {  # part of a command line: why no test runs it
    "pip install": "needs a network; .ci/run installs the package",
    "pip uninstall": "removes what the tests need",
    "apt-get": "needs root",
    "nvidia-smi": "needs a GPU",
    "torch.cuda.init()": "needs a GPU",
    "ssh ": "needs another machine",
    "srun ": "needs Slurm",
    "scontrol ": "needs Slurm",
    "#!": "needs Slurm",
    "#SBATCH": "needs Slurm",
    "--rdzv-id": "needs Slurm",
    "torchrun ": "test_torchrun.py starts such processes",
    "-m morlax_torch.train --env humanoid --output /shared/humanoid": "test_torchrun.py does",
    "python benchmarks/": "takes minutes to hours; test_benchmarks.py imports them",
    "python docs/examples/": "test_examples.py does",
    "train_hydra.py": "test_documents.py does",
    "morlax export runs/cheetah": "test_documents.py and test_export.py do",
    "morlax export go1": "needs mjlab; test_mjlab_play.py exports it",
    "morlax choose g1": "needs mjlab; test_mjlab.py chooses",
    "morlax play": "needs the export of a task of mjlab; test_mjlab_play.py has one",
    "python -m pytest": "starts the tests",
    "morlax design": "needs a run with designs; test_designs.py searches one",
    "--body thigh": "needs a run with designs; test_designs.py films one",
    "morlax explore": "a server; .ci/smoke.py starts it",
    "runs/go1": "needs mjlab; test_mjlab.py trains",
    "mjlab:": "needs older simulators; test_mjlab.py trains",
    "playground:": "brings JAX; test_playground.py trains",
    "gymnasium:mo-": "needs mo-gymnasium; test_mo_gymnasium.py trains",
    "MUJOCO_GL=osmesa": "needs OSMesa",
    "--storage ": "needs a shared folder or a database; test_tune.py has one",
    "best.yaml": "needs the result of a search; test_tune.py trains with it",
    "morlax teach": "asks a user in a browser; test_explore_comparing.py answers",
    "lesson/config.yaml": "needs the answers of a user; test_teach.py trains with it",
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
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        lines = "".join(blocks).replace("\\\n", " ").splitlines()
        lines += [code for code in re.findall(r"`([^`\n]+)`", text) if OURS.match(code)]
        for line in lines:
            for part in line.partition("  # ")[0].split(" && "):
                if part.strip():
                    found.setdefault(" ".join(part.split()), page.stem)
    return [pytest.param(line, id=f"{page}: {line}") for line, page in found.items()]


def reason_not_to_run(line: str) -> str | None:
    return next((reason for part, reason in NOT_RUN.items() if part in line), None)


RUNNABLE = [case for case in printed() if reason_not_to_run(case.values[0]) is None]


def words(line: str) -> list[str]:
    """Return the command's name and arguments, with names that stand for others replaced."""
    assert OURS.match(line), "no test knows how to run it: add it to NOT_RUN, with a reason"
    for name, other in NAMED.items():
        line = re.sub(name, other, line)
    name, *arguments = shlex.split(line.removeprefix("python -m morlax_torch."))
    return arguments if name == "morlax" else [name, *arguments]


@pytest.fixture
def workplace(tmp_path, monkeypatch, make_run) -> Path:
    """Return a folder with a run, and the files and configs that pages name."""
    names = "your-own-robot", "algorithms", "designs"
    page = "".join((ROOT / "docs" / f"{name}.md").read_text() for name in names)
    for text, name in re.findall(r"```\w+\n((?:# |<!-- )([\w.]+\.\w+)\b.*?)```", page, re.DOTALL):
        (tmp_path / name).write_text(text)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    make_run(tmp_path / "run", "cheetah", "best")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def on_the_cpu(arguments: list[str]) -> list[str]:
    """Return the arguments without the device, since tests may have no GPU."""
    if "--device" in arguments:
        place = arguments.index("--device")
        arguments = arguments[:place] + arguments[place + 2 :]
    return [*arguments, "--device", "cpu"]


@pytest.mark.parametrize("line", RUNNABLE)
def test_a_printed_command_is_valid(line, workplace, request):
    name, *arguments = words(line)
    if name == "train":
        train.read(on_the_cpu(arguments))
        return
    if name == "tune":
        pytest.importorskip("optuna", reason="needs the extra tune")
        tune.read(on_the_cpu(arguments))
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
    for option in ("--max-seconds", "--output"):
        if option in arguments:
            place = arguments.index(option)
            arguments = arguments[:place] + arguments[place + 2 :]
    command([name, *on_the_cpu(arguments), *SHORT])
    assert (workplace / "short" / "front.npz").is_file()


def test_reasons_are_not_out_of_date():
    lines = [case.values[0] for case in printed()]
    for part in NOT_RUN:
        assert any(part in line for line in lines), f"no page prints {part}: delete its reason"
