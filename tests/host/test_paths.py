"""A path that cannot be used gets one sentence, from every command, and never hangs it."""

import os

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


def typed(name: str, path: str) -> tuple:
    """Return a command of COMMANDS, and its words with a path."""
    module, words = COMMANDS[name]
    return module, *(word.replace("{}", path) for word in words)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_path_that_is_too_long_or_a_link_to_itself_or_a_pipe(refused, name, workplace):
    for ending in ("", ".npz", ".py"):
        (workplace / f"loop{ending}").symlink_to(f"loop{ending}")
        os.mkfifo(workplace / f"pipe{ending}")
    assert "File name too long" in refused(*typed(name, LONG)) or name in ("robot", "explore")
    if name not in ("pack output", "pack web"):  # which use it last
        refused(*typed(name, "loop"))
    if name not in ("pack output", "pack web", "output"):
        refused(*typed(name, "pipe"))  # is not waited for


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("name", ["evaluate", "output"])
def test_a_folder_that_cannot_be_entered(refused, name, workplace):
    (workplace / "closed").mkdir()
    (workplace / "closed").chmod(0)
    try:
        assert "Permission denied" in refused(*typed(name, "closed/x"))
    finally:
        (workplace / "closed").chmod(0o700)
