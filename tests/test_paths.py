"""A path that cannot be used gets one sentence, from every command, and never hangs it."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

from morlax_torch import MorlaxError, load, save
from morlax_torch.commands import evaluate, explore, export, figures, pack, record, tune
from morlax_torch.commands import train as train_command
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run
from morlax_torch.runs.evaluating import pack as pack_run
from morlax_torch.train import train

LONG = "a" * 5000
COMMANDS = {
    "evaluate": (evaluate, ("{}", "--device", "cpu")),
    "evaluate reference": (evaluate, ("cheetah", "--device", "cpu", "--reference", "{}.npz")),
    "figures": (figures, ("{}",)),
    "figures output": (figures, ("cheetah", "--output", "{}")),
    "record": (record, ("{}",)),
    "export": (export, ("{}",)),
    "explore": (explore, ("{}", "--port", "0")),
    "pack": (pack, ("{}", "packed")),
    "pack web": (pack, ("cheetah", "--web", "{}", "--device", "cpu")),
    "pack output": (pack, ("cheetah", "{}", "--device", "cpu")),
    "resume": (train_command, ("--resume", "{}")),
    "config": (train_command, ("--config", "{}")),
    "output": (train_command, ("--env", "cheetah", "--device", "cpu", "--output", "{}")),
    "space": (tune, ("--env", "cheetah", "--device", "cpu", "--space", "{}")),
    "storage": (tune, ("--env", "cheetah", "--device", "cpu", "--storage", "{}")),
    "tune output": (tune, ("--env", "cheetah", "--device", "cpu", "--output", "{}")),
    "robot": (train_command, ("--env", "{}.py:Robot")),
}


@pytest.fixture
def refused_path(workplace, refused) -> Callable[[str, str], str]:
    """Return a function that runs a command of COMMANDS, which must leave no file."""

    def run(name: str, path: str) -> str:
        module, arguments = COMMANDS[name]
        before = set(workplace.rglob("*"))
        text = refused(module, *(argument.replace("{}", path) for argument in arguments))
        assert set(workplace.rglob("*")) == before
        return text

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_a_path_that_is_too_long_or_a_link_to_itself_or_a_pipe(refused_path, name, tmp_path):
    for ending in ("", ".npz", ".py"):
        (tmp_path / f"loop{ending}").symlink_to(f"loop{ending}")
        os.mkfifo(tmp_path / f"pipe{ending}")
    assert "File name too long" in refused_path(name, LONG) or name in ("robot", "explore")
    if name not in ("pack output", "pack web"):  # which use it last
        refused_path(name, "loop")
    if name not in ("pack output", "pack web", "output"):
        refused_path(name, "pipe")  # is not waited for


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("name", ["evaluate", "output"])
def test_a_folder_that_cannot_be_entered(refused_path, name, tmp_path):
    (tmp_path / "closed").mkdir()
    (tmp_path / "closed").chmod(0)
    try:
        assert "Permission denied" in refused_path(name, "closed/x")
    finally:
        (tmp_path / "closed").chmod(0o700)


PYTHON: dict[str, Callable[[str], object]] = {
    "load": load,
    "save": lambda path: save(load("hopper"), path),
    "train": lambda path: train(tiny(), output=path),
    "load a front": Front.load,
    "pack": lambda path: pack_run("hopper", Path(path), "cpu"),
}


@pytest.mark.parametrize("name", PYTHON)
def test_an_impossible_path_leaves_nothing_behind(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((MorlaxError, OSError), match="File name too long"):
        PYTHON[name]("a" * 300)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_device_for_the_output():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "morlax_torch", "export", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 2
    assert (
        done.stderr == "error: cannot print: no space left on the device that the output goes to.\n"
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_a_run_s_folder_may_be_named_like_a_task(workplace):
    run = "gymnasium:a/robot.py:Robot"
    train(tiny(), output=run)
    train(tiny(max_env_steps=96), Run.open(run))
    assert load(run).objectives == ("run", "jump")
    export.command([run, "--tradeoff", "1,1", "--format", "torchscript"])
    evaluate.command([run, "--device", "cpu"])
    pack.command([run, "mjlab:run"])
    assert train(tiny(start_from="mjlab:run"), output="b:c").folder.is_dir()
