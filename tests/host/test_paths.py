"""A path that cannot be used gets one sentence, from every command, and never hangs it."""

import os
from collections.abc import Callable

import pytest

from morlax_torch.commands import evaluate, explore, export, pack, record
from morlax_torch.commands import train as train_command

LONG = "a" * 5000
COMMANDS = {
    "evaluate": (evaluate, ("{}", "--device", "cpu")),
    "evaluate reference": (evaluate, ("cheetah", "--device", "cpu", "--reference", "{}.npz")),
    "record": (record, ("{}",)),
    "export": (export, ("{}",)),
    "explore": (explore, ("{}", "--port", "0")),
    "pack": (pack, ("{}", "packed")),
    "pack web": (pack, ("cheetah", "--web", "{}", "--device", "cpu")),
    "pack output": (pack, ("cheetah", "{}", "--device", "cpu")),
    "resume": (train_command, ("--resume", "{}")),
    "config": (train_command, ("--config", "{}")),
    "output": (train_command, ("--env", "cheetah", "--device", "cpu", "--output", "{}")),
    "robot": (train_command, ("--env", "{}.py:Robot")),
}


@pytest.fixture
def refused_path(workplace, refused) -> Callable[[str, str], str]:
    """Return a function that runs a command of COMMANDS with a path."""

    def run(name: str, path: str) -> str:
        module, arguments = COMMANDS[name]
        return refused(module, *(argument.replace("{}", path) for argument in arguments))

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
