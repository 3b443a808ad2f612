"""One package of one version, importable from anywhere, whose commands know their names."""

import ast
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from programs import Program, python

import morlax_torch
from morlax_torch import __main__ as commands
from morlax_torch import config_for
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.process import program

ROOT = Path(__file__).parents[2]


def test_citation_and_changelog_name_the_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert morlax_torch.__version__ == citation["version"] == released[0]


def test_every_command_prints_the_version_and_nothing_else(monkeypatch, capfd):
    monkeypatch.setattr(sys, "argv", ["morlax", "--version"])
    modules = [import_module(f"morlax_torch.commands.{name}") for name in commands.COMMANDS]
    for module in (commands, *modules):
        cli.run(module.command)
        assert capfd.readouterr() == (f"morlax_torch {morlax_torch.__version__}\n", "")


@pytest.mark.parametrize(
    "typed, named",
    [
        ("python /venv/bin/morlax train", "morlax train"),
        ("python -m morlax_torch train", "python -m morlax_torch train"),
        ("python -m morlax_torch.train", "python -m morlax_torch train"),
    ],
)
def test_a_command_is_named_as_this_user_can_type_it(typed, named, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", [*typed.split(), "--help"])
    assert program("train") == named


IMPORTS = (
    "morlax_torch.evaluate; morlax_torch.choose; morlax_torch.train",
    "import morlax_torch.train",
    "from morlax_torch.train import train",
    "from morlax_torch import evaluate, choose",
)


@pytest.mark.slow
@pytest.mark.parametrize("orders", [IMPORTS, IMPORTS[::-1]], ids=["package first", "module first"])
def test_public_functions_can_be_imported_and_called_in_any_order(orders, tmp_path):
    lines = ["import gc, sys", "before = gc.get_threshold(), sys.excepthook", "import morlax_torch"]
    lines += ["assert (gc.get_threshold(), sys.excepthook) == before"]
    lines += [*orders, "assert train is morlax_torch.train.train"]
    lines += ["assert callable(evaluate) and choose is morlax_torch.choose"]
    lines += ["try: train(nothing=0)", "except TypeError as e: print(e)"]
    _, output, errors = Program("\n".join(lines), tmp_path).ended()
    assert "train() got an unexpected keyword argument 'nothing'" in output, errors


def test_workflows_pin_actions():
    for file in (ROOT / ".github").rglob("*.yml"):
        for action in re.findall(r"uses: (.*)", file.read_text()):
            assert re.match(r"\./|[\w-]+/[\w-]+@[0-9a-f]{40} # v", action), f"{file}: {action}"


def test_the_package_does_not_contain_itself():
    done = python("-c", "import morlax_torch.morlax_torch", cwd=ROOT)
    assert "ModuleNotFoundError: No module named 'morlax_torch.morlax_torch'" in done.stderr


@pytest.mark.parametrize("name", ["envs", "configs"])
def test_a_folder_of_the_checkout_is_imported_under_one_name_only(name):
    done = python("-c", f"import {name}", cwd=ROOT)
    last = done.stderr.strip().splitlines()[-1]
    assert last == f"ImportError: import this package as morlax_torch.{name}, not as {name}."


@pytest.mark.parametrize("folder", ["envs", "morlax_torch"])
def test_tensors_of_floats_have_a_dtype_whatever_the_user_s_default_is(folder):
    made = {f"torch.{name}" for name in ("zeros", "ones", "empty", "rand", "randn", "linspace")}
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in made:
                words = {keyword.arg for keyword in node.keywords}
                assert words & {"dtype", None}, f"{file}:{node.lineno}: {ast.unparse(node)}"


def test_a_tuned_config_is_one_call():
    config = config_for("ant", worlds=1024, device="cpu", **{"ppo.learning_rate": 1e-3})
    assert (config.env, config.worlds, config.ppo.learning_rate) == ("ant", 1024, 1e-3)
    tuned = config_for("ant", device="cpu")
    assert config.ppo.discount == tuned.ppo.discount
    assert tuned == config_for("ant", device="cpu", ppo={})
