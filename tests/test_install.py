"""The wheel installs one self-contained package."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BUILD_EVERY_TASK = """
import morlax_torch
from morlax_torch import config, config_files, envs
for name in envs.names():
    env = envs.make(name, num_worlds=2, device="cpu")
    assert env.step(env.reset().new_zeros(2, env.action_size)).reward.shape[0] == 2
    config.load_config(config_files.task_values(name, "cpu"))
print(morlax_torch.__file__)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, ROOT],
        check=True,
        capture_output=True,
    )
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_contains_only_its_own_package_and_all_assets(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"morlax_torch"}
    assert "morlax_torch/envs/robots/assets/ant.xml" in names
    assert "morlax_torch/configs/ant.yaml" in names


def test_an_installed_wheel_builds_every_task(wheel, tmp_path):
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", tmp_path, wheel],
        check=True,
        capture_output=True,
    )
    done = subprocess.run(
        [sys.executable, "-c", BUILD_EVERY_TASK],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path), "PATH": ""},
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(tmp_path)
