"""What a command imports, when, and the kernels that are compiled before the first step."""

import gc
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import programs
import pytest
import warp as wp
from tiny import TYPED

from morlax_torch.__main__ import COMMANDS
from morlax_torch.envs.physics import compiling

HEAVY = {"torch", "warp", "mujoco", "matplotlib", "moocore", "websockets", "tensorboard", "onnx"}
TINY = ("--env", "cheetah", *TYPED, "--output", "run")


def python(folder: Path, *words: str, first: Path | None = None, **variables: str) -> Any:
    """Run Python in `folder`; modules in the folder `first` hide others of the same name."""
    path = os.pathsep.join([*([str(first)] if first else []), *sys.path])
    env = {**os.environ, "PYTHONPATH": path, **variables}
    return programs.python(*words, cwd=folder, env=env)


def imported(done: Any) -> set[str]:
    """Return the top-level modules that `python -X importtime` reports."""
    assert done.returncode == 0, done.stderr
    lines = [x for x in done.stderr.splitlines() if x.startswith("import time:")]
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}


@pytest.fixture
def no_torch(tmp_path: Path) -> Path:
    """A folder with a `torch` that cannot be imported."""
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "torch.py").write_text("raise SystemExit('torch was imported')\n")
    return folder


@pytest.mark.parametrize("words", [("-c", "import morlax_torch"), ("-m", "morlax_torch")], ids=str)
def test_the_package_and_its_first_commands_import_nothing_heavy(words, tmp_path):
    assert not imported(python(tmp_path, "-X", "importtime", *words)) & HEAVY


def test_help_imports_nothing_heavy(tmp_path):
    code = (
        "import sys\n"
        "from morlax_torch.__main__ import COMMANDS, command\n"
        "for name in COMMANDS:\n"
        "    try: command([name, '--help'])\n"
        "    except SystemExit: print(name, *{module.split('.')[0] for module in sys.modules})"
    )
    done = python(tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
    found = [line.split() for line in done.stdout.splitlines() if line.split()[:1]]
    modules = {words[0]: set(words) for words in found if words[0] in COMMANDS and len(words) > 50}
    assert modules.keys() == COMMANDS.keys()
    for name in COMMANDS:
        assert not modules[name] & HEAVY, name


@pytest.mark.parametrize("module", [["morlax_torch.train"], ["morlax_torch", "train"]])
def test_training_prints_a_line_before_torch_is_imported(module, tmp_path, no_torch):
    done = python(tmp_path, "-m", *module, *TINY, first=no_torch)
    assert "torch was imported" in done.stderr
    (line,) = done.stdout.splitlines()
    assert line.startswith("starting: train --env cheetah")


def test_mistakes_are_told_without_torch(tmp_path, no_torch):
    done = python(tmp_path, "-m", "morlax_torch.train", "--env", "chetah", first=no_torch)
    assert "did you mean 'cheetah'?" in done.stderr and done.returncode == 2


SCRIPT = "from morlax_torch.__main__ import main\nmain()\n"  # as pip installs it


@pytest.mark.parametrize("library", ["pydantic", "tyro"])
@pytest.mark.parametrize("words", [["-m", "morlax_torch", "evaluate"], ["morlax", "evaluate"]])
def test_ctrl_c_while_a_command_imports_a_library_is_one_word(tmp_path, library, words):
    (tmp_path / "morlax").write_text(SCRIPT)
    interrupt = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
    (tmp_path / f"{library}.py").write_text(interrupt)
    done = python(tmp_path, *words, "cheetah", first=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


@pytest.mark.parametrize(("number", "told"), [(2, "interrupted\n"), (signal.SIGTERM, "")])
def test_a_signal_ends_a_command_while_torch_is_imported(tmp_path, number, told):
    # its C++ code aborts at an exception
    aborts = f"import os\ntry: os.kill(os.getpid(), {number:d})\nexcept BaseException: os.abort()\n"
    (tmp_path / "torch.py").write_text(aborts)
    done = python(tmp_path, "-m", "morlax_torch", "evaluate", "cheetah", first=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", told)


def test_commands_keep_bytecode_where_python_keeps_none(tmp_path):
    forbidden = {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPYCACHEPREFIX": ""}
    words = "-m", "morlax_torch", "--version"
    done = python(tmp_path, *words, **forbidden, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert done.returncode == 0
    assert [*tmp_path.glob("cache/morlax/bytecode/**/morlax_torch/__main__*.pyc")]
    # the user's own folder comes first, and a folder that cannot be written is no error
    own = {"PYTHONPYCACHEPREFIX": str(tmp_path / "own")}
    assert not python(tmp_path, *words, **own, XDG_CACHE_HOME=str(tmp_path / "new")).returncode
    assert not (tmp_path / "new").exists()
    assert not python(tmp_path, *words, **forbidden, XDG_CACHE_HOME="/dev/null").returncode


@pytest.mark.slow
def test_training_on_c_mujoco_imports_no_warp_no_viewer_and_no_optional_library(tmp_path):
    done = python(tmp_path, "-X", "importtime", "-m", "morlax_torch.train", *TINY)
    modules = imported(done)
    assert not modules & {"warp", "mujoco_warp", "websockets", "onnx", "pandas", "triton"}
    assert not modules & {"stable_baselines3", "torchrl", "rsl_rl", "skrl", "tensordict", "wandb"}
    assert not modules & {"mo_gymnasium", "morl_baselines", "array_api_compat"}
    assert "matplotlib" in modules and "matplotlib.pyplot" not in done.stderr
    assert (tmp_path / "run" / "front.npz").is_file()


COMPILE = """
import pathlib
import torch, warp
from morlax_torch import envs
from morlax_torch.envs.physics import compiling

log, compiled = pathlib.Path("compiled"), warp.Module._compile
def logged(module, *arguments, **named):
    with log.open("a") as file:
        file.write(f"{module.name}\\n")
    return compiled(module, *arguments, **named)
warp.Module._compile = logged
env = envs.make(TASK, 4, DEVICE, "warp")
envs.make(TASK, 4, DEVICE, "warp")  # starts while the first processes compile
compiling.finish()
times = log.read_text().count("mujoco_warp._src.smooth")
modules = lambda: {f.name for f in pathlib.Path(warp.config.kernel_cache_dir).glob("*/*.meta")}
ahead = modules()
for _ in range(2):
    env.step(torch.zeros(4, env.action_size, device=DEVICE))
assert torch.isfinite(env.physics.qpos).all()
print(len(ahead), len(modules() - ahead), times)
"""
LONG = [pytest.mark.slow, pytest.mark.long]


@pytest.mark.parametrize(
    ("task", "device"),
    [
        pytest.param("cheetah", "cpu", marks=LONG),
        pytest.param("bruce", "cpu", marks=LONG),
        pytest.param("cheetah", "cuda", marks=pytest.mark.gpu),
        pytest.param("bruce", "cuda", marks=pytest.mark.gpu),
    ],
)
def test_warp_compiles_in_other_processes_before_the_first_step(task, device, tmp_path):
    script = COMPILE.replace("TASK", repr(task)).replace("DEVICE", repr(device))
    done = python(tmp_path, "-c", script, WARP_CACHE_PATH=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr
    ahead, later, times = map(int, done.stdout.split())
    assert ahead > 20 and later == 0 and times == 1


def test_a_cache_that_warp_cannot_make_is_named(tmp_path):
    (tmp_path / "file").touch()
    words = "-m", "morlax_torch", "train", *TINY, "--backend", "warp"
    done = python(tmp_path, *words, WARP_CACHE_PATH=str(tmp_path / "file" / "cache"))
    assert done.returncode == 2
    assert "set WARP_CACHE_PATH to a folder" in " ".join(done.stderr.split())


class Module:
    """Stands in for one of Warp's that two processes compile; the second never ends."""

    def resolve_options(self, config: object, block: int) -> None:
        pass

    def _compile(self, device: object, options: object) -> None:
        counter.value += 10 * gc.isenabled()
        while counter.value > 1:
            time.sleep(1)


counter = compiling._fork.Value("i", 0)


def test_processes_that_compile_collect_no_garbage_and_are_not_waited_for_forever(monkeypatch):
    wp.init()
    monkeypatch.setattr(compiling, "MOST_SECONDS", 1.0)
    variants = [(Module(), "cpu", 1)] * 2
    process = compiling._fork.Process(target=compiling._compile, args=(variants, counter))
    process.start()
    compiling._running.append((process, counter))
    compiling.finish()
    # what the parent left may wait for threads that only the parent has
    assert counter.value == 2 and process.exitcode == -signal.SIGKILL
