"""One copy of each module, importable from anywhere, and the documented calls at the top."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import morlax_torch
from morlax_torch import config_for

ROOT = Path(__file__).parents[1]


def python(code: str, folder: Path) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder)


def test_the_package_does_not_contain_itself():
    done = python("import morlax_torch.morlax_torch", ROOT)
    assert "ModuleNotFoundError: No module named 'morlax_torch.morlax_torch'" in done.stderr


@pytest.mark.parametrize("name", ["envs", "configs"])
def test_a_folder_of_the_checkout_is_imported_under_one_name_only(name):
    done = python(f"import {name}", ROOT)
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
    assert tuned == morlax_torch.config_for("ant", device="cpu", ppo={})
