"""Custom tasks support everything that built-in tasks do, and their mistakes are explained."""

import re
import sys
from pathlib import Path

import gymnasium
import pytest
import torch
import yaml
from tiny import TYPED

from morlax_torch import MorlaxError, envs, load
from morlax_torch.commands import evaluate, explore, record, train
from morlax_torch.exports.manifest import manifest
from morlax_torch.terminal import arguments
from morlax_torch.viewers.player import Player

PAGE = Path(__file__).parent.parent / "docs" / "your-own-robot.md"


def shown(name: str) -> str:
    """Return the source of a file as shown on the documentation page."""
    found = re.search(rf"```\w+\n((?:# |<!-- ){re.escape(name)}\b.*?)```", PAGE.read_text(), re.S)
    assert found, name
    return found[1]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("crawler.xml", "crawler.py"):
        (tmp_path / name).write_text(shown(name))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
    return tmp_path


@pytest.fixture
def trained(folder: Path) -> Path:
    train.command(["--env", "crawler.py:Crawler", *TYPED])
    (run,) = (folder / "runs" / "Crawler").iterdir()
    return run


# Every command


def test_the_documented_robot_can_be_resumed_evaluated_played_and_exported(
    trained, folder, monkeypatch, capsys, refused
):
    config = yaml.safe_load((trained / "config.yaml").read_text())
    assert config["env"] == f"{folder.resolve() / 'crawler.py'}:Crawler"
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    train.command(["--resume", str(trained), "--max-env-steps", "640"])
    evaluate.command([str(trained), "--tradeoffs", "5"])
    assert (trained / "report.html").is_file()
    printed = capsys.readouterr().out
    assert "Crawler: run, energy" in printed
    assert str(folder / "crawler.py") not in printed
    policy = load(trained)
    player = Player(policy, (0.5, 0.5))
    player.step()
    assert player.steps == 1
    names = [part["name"] for part in manifest(policy)["observation"]]
    assert names[:3] == ["position.z", "position.pitch", "position.shoulder"]

    (folder / "crawler.py").rename(folder / "moved.py")
    for module in (evaluate, record, explore):
        text = refused(module, trained)
        assert "crawler.py, which should define the task Crawler" in text


def test_a_custom_robot_can_be_recorded(trained, folder, opengl):
    small = ("--width", "64", "--height", "64", "--seconds", "0.1")
    record.command([str(trained), "--output", "film.gif", *small])
    assert (folder / "film.gif").stat().st_size > 0


def test_the_command_line_accepts_a_custom_task_s_options(folder):
    text = (folder / "crawler.py").read_text()
    own = "        hurry: float = 2.0\n        nconmax"
    (folder / "crawler.py").write_text(text.replace("        nconmax", own))
    typed = ("--env", "./crawler.py:Crawler", "--device", "cpu", "--task.hurry", "3")
    config = arguments.read(typed)[0]
    assert config.task.model_dump()["hurry"] == 3
    assert config.worlds == 1024  # from configs/default.yaml
    (folder / "there").mkdir()
    names = ("crawler.py:Crawler", "there/../crawler.py:Crawler", f"{folder}/crawler.py:Crawler")
    assert len({envs.get(name) for name in names}) == 1


@pytest.mark.parametrize("backend", ("mujoco", "warp"))
def test_a_custom_robot_runs_on_both_simulators(folder, backend):
    env = envs.make("crawler.py:Crawler", 4, "cpu", backend)
    for _ in range(30):
        step = env.step(torch.ones(4, 2))
    assert step.reward.isfinite().all()
    assert env.blowups == 0 and (env.overflow() == 0).all()
    with pytest.raises(MorlaxError, match="unknown reward term 'rum': did you mean 'run'"):
        envs.make("crawler.py:Crawler", 3, "cpu", shared={"rum": 1.0})


# Files


UNKNOWN = {
    "crawler.py:Crawlr": "did you mean 'Crawler'",
    "crawler.py:positions": "Known: Crawler",
    "crawler.py": "name a class in it, such as crawler.py:MyRobot",
    "nowhere.py:Crawler": "there is no file",
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_an_unknown_class_or_file_gives_a_clear_error(folder, name):
    with pytest.raises(MorlaxError, match=re.escape(UNKNOWN[name])):
        envs.get(name)


FAILURES = {
    "import no_such_module": "line 3, cannot be imported: ModuleNotFoundError: No module",
    "def (": "cannot be imported: SyntaxError",
    "import sys; sys.exit()": "line 3, cannot be imported: SystemExit",
}


@pytest.mark.parametrize("line", FAILURES)
def test_a_failing_file_gives_a_clear_error_and_can_be_fixed(folder, line):
    good = (folder / "crawler.py").read_text()
    (folder / "crawler.py").write_text(good.replace("import numpy as np", f"\n{line}", 1))
    with pytest.raises(MorlaxError, match=re.escape(FAILURES[line])):
        envs.get("crawler.py:Crawler")
    (folder / "crawler.py").write_text(good)
    assert envs.get("crawler.py:Crawler").__name__ == "Crawler"


# Mistakes in a task class


METHODS = {
    "initial_qpos(self): return [0.0] * 4": "initial_qpos() has shape (4,): it must be (5,), one",
    "observe(self): return self.physics.qpos.T": "observe() has shape (5, 3): it must be (3, O)",
    "observe(self): return self.physics.sensor('gyro')": "unknown sensor 'gyro'",
    "privileged(self): return self.age": "privileged() has shape (3,): it must be (3, P)",
    "terms(self): return {'run': 1.0}": "terms()['run'] has shape (): it must be (3,), one number",
    "failed(self): return self.physics.qpos[:, 2]": (
        "failed() has shape (3,) of torch.float64: it must be (3,) of torch.bool"
    ),
    "apply(self, action): self.physics.ctrl.copy_(action[:, :1].repeat(1, 3))": (
        "apply() cannot turn actions of shape (3, 2) into physics.ctrl of shape (3, 2)"
    ),
    "apply(self, action): self.physics.ctrl = action": "apply() rebinds physics.ctrl",
    "layout(self): return [Part('all', 3, '')]": "layout() names 3 numbers, but observe() gives 9",
}


@pytest.mark.parametrize("method", METHODS)
def test_errors_name_wrong_shapes(folder, method):
    with (folder / "crawler.py").open("a") as file:
        file.write(f"\n    def {method}\n")
    with pytest.raises(MorlaxError, match=re.escape(METHODS[method])):
        envs.make("crawler.py:Crawler", 3, "cpu")


INCOMPLETE = {
    "def failed": ("def fails", "Crawler does not define failed, which every task needs."),
    "class Options": ("class Choices", "Crawler.Options must be a subclass of ObjectiveOptions"),
    'model_file = "crawler.xml"': ("", "Crawler names no MJCF: give it a model_file."),
    '"crawler.xml"': ('"crawl.xml"', "MuJoCo cannot load"),
}


@pytest.mark.parametrize("old", INCOMPLETE)
def test_an_incomplete_task_class_gives_a_clear_error(folder, old):
    new, expected = INCOMPLETE[old]
    text = (folder / "crawler.py").read_text()
    assert old in text
    (folder / "crawler.py").write_text(text.replace(old, new))
    with pytest.raises(MorlaxError, match=re.escape(expected)):
        envs.make("crawler.py:Crawler", 3, "cpu")


def test_pushes_need_a_robot_that_can_move_horizontally(folder):
    text = (folder / "crawler.xml").read_text()
    turning = text.replace('name="x" type="slide" axis="1 0 0"', 'name="x"')
    (folder / "crawler.xml").write_text(turning)
    with pytest.raises(MorlaxError, match="this robot cannot be pushed"):
        envs.make("crawler.py:Crawler", 3, "cpu", randomization={"push": 1.0})


# Entry points


@pytest.fixture
def offer(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package with an entry point."""

    def install(package: str, line: str) -> None:
        site = folder / f"site-{package}"
        info = site / f"{package}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[morlax_torch.envs]\n{line}\n")
        for name in ("crawler.xml", "crawler.py"):
            (site / name.replace("crawler.py", f"{package}.py")).write_text(shown(name))
        monkeypatch.syspath_prepend(site)

    yield install
    for name in [name for name in sys.modules if name.startswith("offered_")]:
        del sys.modules[name]


def test_an_entry_point_is_imported_only_when_its_task_is_used(offer):
    offer("offered_one", "my_crawler = offered_one:Crawler")
    assert "my_crawler" in envs.names()
    assert "offered_one" not in sys.modules
    assert envs.make("my_crawler", 2, "cpu").objectives == ("run", "energy")
    assert "offered_one" in sys.modules
    assert "morlax_torch/MyCrawler-v0" in gymnasium.registry
    del gymnasium.registry["morlax_torch/MyCrawler-v0"]


BROKEN = {
    "offered_none:Crawler": "cannot be imported from offered_none:Crawler: ModuleNot",
    "offered_two:Nobody": "cannot be imported from offered_two:Nobody: AttributeError",
    "offered_two:positions": "is offered_two:positions, which is not a subclass of",
}


@pytest.mark.parametrize("place", BROKEN)
def test_a_broken_entry_point_does_not_affect_other_tasks(offer, place):
    offer("offered_two", f"bad = {place}")
    assert "bad" in envs.names()
    assert envs.get("hopper").__name__ == "Hopper"
    with pytest.raises(MorlaxError, match=re.escape(BROKEN[place])):
        envs.get("bad")


def test_two_entry_points_with_one_name_are_rejected_and_built_in_names_kept(offer):
    offer("offered_three", "twin = offered_three:Crawler")
    offer("offered_four", "twin = offered_four:Crawler")
    with pytest.raises(MorlaxError, match="several packages offer an environment called 'twin'"):
        envs.get("twin")
    offer("offered_five", "ant = offered_five:Crawler")
    assert envs.get("ant").__name__ == "Ant"
    assert envs.names().count("ant") == 1
    with pytest.raises(MorlaxError, match="there is already an environment called 'ant'"):
        envs.register("ant", envs.get("crawler.py:Crawler"))
