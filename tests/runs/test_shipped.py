"""The shipped policies reproduce their stored fronts."""

import re
import shlex
from pathlib import Path

import pytest
import torch

from morlax_torch import envs
from morlax_torch.commands.terminal import arguments
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.loading import SHIPPED, evaluate, find_run, load

NUMBERS = {"cheetah": 64, "cheetah3": 256, "walker": 256}  # of trade-offs; all others: 512
MEGABYTES = {"humanoid": 6.0, "bruce": 6.0}  # all others: 1
OF_PEERS = {"go1", "g1", "g1-tour"}  # tested where mjlab is installed
SHIPS = sorted(folder.name for folder in SHIPPED.iterdir() if folder.name not in OF_PEERS)


def test_every_built_in_task_has_a_shipped_policy():
    assert set(SHIPS) == {name for name in envs.names() if "/" not in name}


@pytest.mark.parametrize("name", SHIPS)
def test_a_shipped_policy_is_small_and_has_its_config_and_metrics(name):
    folder = find_run(name)
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    assert size < 1e6 * MEGABYTES.get(name, 1.0)
    policy = load(name)
    assert policy.config.env == name
    assert policy.objectives == Front.load(folder / "front.npz").objectives
    assert (folder / "metrics.csv").is_file()


def test_an_export_named_like_a_shipped_policy_does_not_hide_it(workplace):
    (workplace / "ant").mkdir()
    assert find_run("ant").parent == SHIPPED
    (workplace / "ant" / "checkpoints").mkdir()
    assert find_run("ant") == Path("ant")


@pytest.mark.parametrize("name", SHIPS)
def test_the_gallery_s_command_gives_the_shipped_config(name, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "tasks.md").read_text()
    (line,) = re.findall(rf"^morlax train (--env {name} .*)", page, re.MULTILINE)
    monkeypatch.setattr(envs, "resolve_device", lambda _: torch.device("cuda:0"))
    config, _, _ = arguments.read(shlex.split(line))
    shipped = load(name, "cpu").config
    assert config.model_dump(exclude={"target"}) == shipped.model_dump(exclude={"target"})


# All were evaluated on MuJoCo Warp; C MuJoCo orients the contact frames of an ant differently.
LONG = [pytest.mark.slow, pytest.mark.long]
MARKS = {"cheetah": [], "humanoid": LONG, "bruce": LONG}
CASES = [
    pytest.param(
        *(name, "mujoco", 0.04 if name == "ant" else 0.02),
        marks=MARKS.get(name, [pytest.mark.slow]),
    )
    for name in SHIPS
]
ON_WARP = pytest.param("ant", "warp", 0.02, marks=LONG)


@pytest.mark.parametrize(("name", "backend", "within"), [*CASES, ON_WARP])
def test_a_shipped_policy_reproduces_its_hypervolume(name, backend, within):
    stored = Front.load(find_run(name) / "front.npz").hypervolume
    found = evaluate(name, NUMBERS.get(name, 512), device="cpu", backend=backend).hypervolume
    assert found == pytest.approx(stored, rel=within)
