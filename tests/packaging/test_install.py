"""The wheel installs one self-contained package."""

import shutil
import zipfile
from pathlib import Path

import pytest
from programs import python

from morlax_torch import __version__

ROOT = Path(__file__).parents[2]
LARGEST = 25e6  # bytes of the wheel
BUILD_EVERY_TASK = """
import morlax_torch
from morlax_torch.configuration import config, files as config_files
from morlax_torch import envs
for name in envs.names():
    env = envs.make(name, num_worlds=2, device="cpu")
    assert env.step(env.reset().new_zeros(2, env.action_size)).reward.shape[0] == 2
    config.load_config(config_files.task_values(name, "cpu"))
print(morlax_torch.__file__)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"  # a copy, since tests in other processes build the wheel too
    for name in ("morlax_torch", "envs", "configs"):
        shutil.copytree(ROOT / name, sources / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    python("-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, sources, check=True)
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_contains_only_its_own_package_and_all_assets(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"morlax_torch"}
    assert "morlax_torch/envs/robots/assets/ant.xml" in names
    assert "morlax_torch/configs/ant.yaml" in names
    assert wheel.name == f"morlax_torch-{__version__}-py3-none-any.whl"
    assert wheel.stat().st_size < LARGEST


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """Return a folder that holds the wheel's contents, and nothing of the checkout."""
    folder = tmp_path_factory.mktemp("installed")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


@pytest.mark.slow
def test_an_installed_wheel_builds_every_task(installed):
    variables = {"PYTHONPATH": str(installed), "PATH": ""}
    done = python("-c", BUILD_EVERY_TASK, cwd=installed, env=variables)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(installed)
