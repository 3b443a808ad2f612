"""The version is the same everywhere, and each command knows it and its own name."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import morlax_torch
from morlax_torch import __main__ as commands
from morlax_torch.envs.errors import installation
from morlax_torch.terminal.startup import program

ROOT = Path(__file__).parents[1]


def python(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *words], capture_output=True, text=True)


def test_citation_and_changelog_name_the_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert morlax_torch.__version__ == citation["version"] == released[0]


def test_changes_to_come_have_a_place_on_top_of_the_changelog():
    headings = re.findall(r"^## .*", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "## [Unreleased]"


@pytest.mark.parametrize("module", ["", *(f".{name}" for name in commands.COMMANDS)])
def test_every_command_prints_the_version_and_nothing_else(module):
    done = python("-m", f"morlax_torch{module}", "--version")
    assert done.stdout == f"morlax_torch {morlax_torch.__version__}\n", done.stderr
    assert done.returncode == 0 and not done.stderr


TYPED = {
    "morlax train": ["python", "/venv/bin/morlax", "train", "--help"],
    "morlax-train": ["python", "/venv/bin/morlax-train", "--help"],
    "python -m morlax_torch train": ["python", "-m", "morlax_torch", "train", "--help"],
    "python -m morlax_torch.train": ["python", "-m", "morlax_torch.train", "--help"],
}


@pytest.mark.parametrize("typed", TYPED)
def test_a_command_is_called_as_it_was_typed(typed, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", TYPED[typed])
    assert program("train") == typed


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_help_names_the_command_that_was_typed(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "orig_argv", ["python", "/venv/bin/morlax", name, "--help"])
    with pytest.raises(SystemExit) as ended:
        commands.command([name, "--help"])
    assert ended.value.code == 0
    assert f"usage: morlax {name} " in " ".join(capsys.readouterr().out.split())


def test_help_lists_every_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "orig_argv", ["python", "-m", "morlax_torch", "--help"])
    commands.command(["--help"])
    first, *others = capsys.readouterr().out.splitlines()
    assert first.startswith("usage: python -m morlax_torch COMMAND ")
    assert [line.split()[0] for line in others] == [*commands.COMMANDS, "--version"]


def test_an_extra_is_installed_from_pypi_or_a_checkout():
    sentence = installation("tune")
    assert "pip install 'morlax-torch[tune]'" in sentence and "pip install '.[tune]'" in sentence
