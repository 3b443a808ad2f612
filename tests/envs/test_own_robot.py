"""Custom tasks support everything that built-in tasks do, and their mistakes are explained."""

import re
import shutil
import sys
from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pytest
import torch
import yaml
from tiny import TYPED, tiny
from web_robots import wedge

from morlax_torch import MorlaxError, envs, load
from morlax_torch.commands import evaluate, explore, export, pack, record, train
from morlax_torch.commands.terminal import arguments
from morlax_torch.envs.errors import MorlaxWarning
from morlax_torch.envs.external import parts_of
from morlax_torch.evaluation.front import Front
from morlax_torch.exports.exporting import manifest
from morlax_torch.runs.references import copy_files
from morlax_torch.viewers.player import Player

PAGE = Path(__file__).parents[2] / "docs" / "your-own-robot.md"


def shown(name: str) -> str:
    """Return the source of a file as shown on the documentation page."""
    found = re.search(rf"```\w+\n((?:# |<!-- ){re.escape(name)}\b.*?)```", PAGE.read_text(), re.S)
    assert found, name
    return found[1]


@pytest.fixture
def folder(workplace: Path) -> Path:
    for name in ("crawler.xml", "crawler.py"):
        (workplace / name).write_text(shown(name))
    return workplace


@pytest.fixture
def trained(folder: Path) -> Path:
    train.command(["--env", "crawler.py:Crawler", *TYPED])
    (run,) = (folder / "runs" / "Crawler").iterdir()
    return run


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
        assert f"would run the code of {trained}/task/crawler.py:Crawler" in text


@pytest.fixture
def moved(trained, tmp_path_factory) -> Path:
    """The run on another computer, where its task has never been."""
    place = tmp_path_factory.mktemp("elsewhere")
    shutil.move(trained, place / "run")
    for name in ("crawler.py", "crawler.xml"):
        (trained.parents[2] / name).unlink()
    return place / "run"


@pytest.mark.slow
def test_a_run_of_a_custom_robot_can_be_moved(moved, monkeypatch, capsys):
    monkeypatch.chdir(moved.parent)
    before = Front.load("run/front.npz")
    with pytest.raises(MorlaxError, match=r"would run the code of .*run/task/crawler.py:Crawler"):
        load("run")
    policy = load("run", trust=True)
    assert policy.config.env == f"{moved.resolve()}/task/crawler.py:Crawler"
    evaluate.command(["run", "--trust", "--device", "cpu"])
    np.testing.assert_array_equal(Front.load("run/front.npz").returns, before.returns)
    export.command(["run", "--trust", "--format", "torchscript", "--tradeoff", "1,1"])
    train.command(["--resume", "run", "--trust", "--max-env-steps", "640"])
    assert "done: 640 steps" in capsys.readouterr().out
    pack.command(["run", "packed", "--trust"])
    shutil.rmtree("run")
    assert load("packed", trust=True).objectives == policy.objectives


def test_a_moved_checkpoint_alone_needs_the_name_of_its_task(moved, folder, monkeypatch, refused):
    monkeypatch.chdir(folder)
    shutil.copy(moved / "checkpoints" / "best.pt", "robot.pt")
    for name in ("crawler.py", "crawler.xml"):
        Path("tasks", name).parent.mkdir(exist_ok=True)
        Path("tasks", name).write_text(shown(name))
    for use in (evaluate, export, explore, record):
        assert "--env FILE.py:Crawler, or from Python load(..., env" in refused(use, "robot.pt")
    named = "tasks/crawler.py:Crawler"
    assert load("robot.pt", env=named).objectives == ("run", "energy")
    evaluate.command(["robot.pt", "--env", named, "--device", "cpu", "--tradeoffs", "4"])
    for wrong, words in {
        "tasks/crawler.py:Crawl": "is of the task Crawler, but --env .*crawler.py:Crawl'",
        "hopper": "name FILE.py:Crawler",
    }.items():
        with pytest.raises(MorlaxError, match=words):
            load("robot.pt", env=wrong)
    assert "leave out --env" in refused(export, "hopper", "--env", named)
    train.command(["--resume", str(moved), "--env", named, "--max-env-steps", "640"])
    assert load(moved).config.env == f"{folder}/tasks/crawler.py:Crawler"


def test_a_run_keeps_its_task_when_the_file_is_edited(trained, folder):
    rewards = load(trained).config.task.objectives
    text = (folder / "crawler.py").read_text()
    (folder / "crawler.py").write_text(text.replace("substeps = 4", "substeps = 2"))
    words = rf"{folder}/crawler.py is not as it was .* name {folder}/crawler.py:Crawler with --env"
    with pytest.warns(MorlaxWarning, match=words):
        policy = load(trained, trust=True)
    assert policy.config.task.objectives == rewards
    assert envs.get(policy.config.env).substeps == 4
    chosen = load(trained, env="crawler.py:Crawler").config.env
    assert chosen == f"{folder}/crawler.py:Crawler"


def edit_model(folder: Path, old: str, new: str) -> None:
    text = (folder / "crawler.xml").read_text()
    assert old in text
    (folder / "crawler.xml").write_text(text.replace(old, new))


NAMED = ("--env", "crawler.py:Crawler")


def test_an_edited_model_is_noticed_and_the_run_keeps_its_report(trained, folder, capsys):
    evaluate.command([str(trained), "--device", "cpu", "--tradeoffs", "4"])
    before = {file: file.read_bytes() for file in trained.glob("*.*")}
    edit_model(folder, 'mass="3"', 'mass="5"')
    with pytest.warns(MorlaxWarning, match=r"is not the one .*best.pt was trained .*: .*body"):
        evaluate.command([str(trained), *NAMED, "--device", "cpu", "--tradeoffs", "4"])
    assert {file: file.read_bytes() for file in trained.glob("*.*")} == before
    assert "written: evaluations/" in capsys.readouterr().out
    with pytest.warns(MorlaxWarning, match=r"model is not the one .*latest.pt was trained with"):
        train.command(["--resume", str(trained), *NAMED, "--max-env-steps", "640"])


JOINT = '<joint name="shoulder" range="-60 100"/>'


@pytest.mark.filterwarnings("ignore:the robot's model is not the one:UserWarning")
def test_a_model_with_another_joint_is_refused_with_both_sizes(trained, folder, refused):
    edit_model(folder, JOINT, JOINT + '<joint name="twist" axis="1 0 0" range="-9 9"/>')
    for module in (evaluate, export, record):
        text = refused(module, trained, *NAMED)
        assert "take 9 observations and return 2 actions, but the task has 11 and 2" in text
    with pytest.raises(MorlaxError, match="observation_size 9, but the task has 11"):
        train.command(["--resume", str(trained), *NAMED, "--max-env-steps", "640"])


def test_a_task_s_model_travels_with_its_parts(folder, tmp_path_factory):
    """Also if it lies beside the folder of its task; what is too large stays."""
    (folder / "tasks").mkdir()
    (folder / "models" / "meshes").mkdir(parents=True)
    (folder / "models" / "arm.xml").write_text(shown("crawler.xml").replace("trunk", "torso"))
    (folder / "models" / "crawler.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><include file="part.xml"/></mujoco>'
    )
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (folder / "models" / "meshes" / "a.obj").write_text(mesh)
    asset = '<asset><mesh name="a" file="a.obj"/></asset>'
    inside = shown("crawler.xml").replace("<worldbody>", f"{asset}<worldbody>")
    (folder / "models" / "part.xml").write_text(inside)
    text = shown("crawler.py").replace('"crawler.xml"', '"../models/crawler.xml"')
    (folder / "tasks" / "robot.py").write_text(text)
    run = tmp_path_factory.mktemp("run")
    copy_files(tiny(f"{folder}/tasks/robot.py:Crawler"), run)
    copies = {str(file.relative_to(run)) for file in run.rglob("*") if file.is_file()}
    models = {f"task/models/{name}" for name in ("crawler.xml", "part.xml", "meshes/a.obj")}
    assert copies == {"task/tasks/robot.py", *models}
    shutil.rmtree(folder / "models")
    assert envs.make(f"{run}/task/tasks/robot.py:Crawler", 1, "cpu").physics.model.nmesh == 1

    with (run / "task" / "models" / "meshes" / "a.obj").open("a") as file:
        file.write("#" * 21 * 2**20)
    copy_files(tiny(f"{run}/task/tasks/robot.py:Crawler"), folder / "new")
    assert not (folder / "new").exists()


HILLS = '<asset><hfield name="hills" file="hills.png" size="9 9 1 1"/></asset>'
GROUND = '<worldbody><geom type="hfield" hfield="hills"/></worldbody>'
LINK = (
    '<link name="base"><collision><geometry><mesh filename="a.stl"/></geometry></collision></link>'
)


@pytest.mark.parametrize(
    ("model", "text", "part"),
    [
        ("arm.urdf", f'<robot name="arm"><mujoco>{{}}</mujoco>{LINK}</robot>', "a.stl"),
        ("arm.xml", f"<mujoco>{{}}{HILLS}{GROUND}</mujoco>", "hills.png"),
    ],
)
def test_meshes_of_a_urdf_and_height_fields_travel_with_their_task(folder, model, text, part):
    (folder / "assets").mkdir()
    (folder / "assets" / "a.stl").write_bytes(wedge())
    plt.imsave(folder / "assets" / "hills.png", np.eye(4))
    (folder / model).write_text(text.format('<compiler meshdir="assets"/>'))
    (folder / "arm.py").write_text(f'model_file = "{model}"')
    found = {str(file.relative_to(folder)) for file in parts_of(folder / "arm.py")}
    assert found == {"arm.py", model, f"assets/{part}"}
    mujoco.MjModel.from_xml_path(str(folder / model))
    (folder / "assets" / part).unlink()
    with pytest.raises(ValueError, match=part):  # which it needs
        mujoco.MjModel.from_xml_path(str(folder / model))


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


def test_a_robot_that_draws_goals_can_be_evaluated_in_several_episodes(folder):
    several = {"evaluation.seeds": 3}
    with pytest.raises(MorlaxError, match="nothing in this task is random"):
        tiny("crawler.py:Crawler", **several)
    with (folder / "crawler.py").open("a") as file:
        file.write("\n    def begin(self, fresh): ...\n")
    shutil.copy("crawler.py", "seeker.py")
    assert tiny("seeker.py:Crawler", **several).task.for_evaluation().varies


def test_a_declared_command_can_be_steered(folder):
    with (folder / "crawler.py").open("a") as file:
        file.write("\n    command_limits = {'m/s': (-1.0, 1.0)}")
        command, last = "torch.zeros(1).expand(2, 1)", "torch.zeros(2, self.action_size)"
        state = f"{{'command': {command}, 'last': {last}}}"
        file.write(f"\n    def initial_state(self): return {state}\n")
    env = envs.make("crawler.py:Crawler", 2, "cpu")
    env.command[0] = 0.5
    env.state["last"] += 1.0
    assert env.state_dict()["state.command"].tolist() == [[0.5], [0.0]]


def test_a_custom_robot_runs_on_both_simulators(folder, backend):
    env = envs.make("crawler.py:Crawler", 4, "cpu", backend)
    for _ in range(30):
        step = env.step(torch.ones(4, 2))
    assert step.reward.isfinite().all()
    assert env.blowups == 0 and (env.overflow() == 0).all()


def test_an_unknown_class_or_file_gives_a_clear_error(folder):
    with pytest.raises(MorlaxError, match="did you mean 'Crawler'"):
        envs.get("crawler.py:Crawlr")
    with pytest.raises(MorlaxError, match="there is no file"):
        envs.get("nowhere.py:Crawler")
    with pytest.raises(MorlaxError, match=r"must be a string, not .*crawler\.py"):
        envs.make(folder / "crawler.py", 2, "cpu")


FAILURES = {
    "import no_such_module": "cannot be imported: ModuleNotFoundError: No module",
    "import sys; sys.exit()": "cannot be imported: SystemExit",
}


@pytest.mark.parametrize("line", FAILURES)
def test_a_failing_file_gives_a_clear_error_and_can_be_fixed(folder, line):
    good = (folder / "crawler.py").read_text()
    (folder / "crawler.py").write_text(good.replace("import numpy as np", f"\n{line}", 1))
    with pytest.raises(MorlaxError, match=rf"{FAILURES[line]}.* \(.*crawler.py, line 3\)"):
        envs.get("crawler.py:Crawler")
    (folder / "crawler.py").write_text(good)
    assert envs.get("crawler.py:Crawler").__name__ == "Crawler"


MISTAKES = {  # lines at the end of the class
    "def initial_qpos(self): return [0.0] * 4": "has type ndarray and shape (4,)",
    "def initial_qpos(self): return [float('nan')] * 5": "(5,), one finite number per qpos",
    "def terms(self): return {'forward': np.zeros(3)}": "must be a tensor (3, ...)",
    "def terms(self): return {'forward': self.speeed()}": (
        "Crawler.terms() fails: AttributeError: 'Crawler' object has no attribute 'speeed' ("
    ),
    "def failed(self): return self.age / nothing": "failed() fails: NameError: name 'nothing' is",
    "def observe(self): return torch.cat([self.physics.qpos, self.age])": "observe() fails",
    "def remember(self): self.x = 0": "remember() has type NoneType and shape (): it must be a",
    "def initial_state(self): return {'x': 0.0}": "initial_state()['x'] has type float",
    "def begin(self, fresh): self.goals.copy_(fresh)": (
        "Crawler.reset() fails: AttributeError: 'Crawler' object has no attribute 'goals' ("
    ),
    "def begin(self, fresh): self.physics.qpos = self.physics.qpos + 1": (
        "physics.qpos is the simulator's own memory, which no other tensor can replace: write into"
    ),
    "def begin(self, fresh): self.state['x'] = fresh": "state['x'] cannot be replaced: declare it",
    "def begin(self, fresh): self.state.update(x=fresh)": "state['x'] cannot be replaced",
    "def begin(self, fresh): self.state |= {'x': fresh}": "state['x'] cannot be replaced",
    "class Options(TaskOptions.__base__): objectives: dict = {}": "be a subclass of TaskOptions",
    "class Options(TaskOptions): objectives: dict = {'run': {'run': 1}}": (
        "Crawler.Options needs a valid default: objectives: a trade-off needs at least two"
    ),
    "class Options(Options): gain: float": "Crawler.Options needs a valid default: gain: Field",
    "substeps = 0.02 / 0.005": "Crawler.substeps is 4.0: it must be a whole number, at least",
    "def observe(self): return self.physics.qpos.T": "shape (5, 3): it must be a tensor (3, O)",
    "def apply(self, action): self.physics.ctrl.copy_(action[:, :1].repeat(1, 3))": (
        "apply() cannot turn actions of shape (3, 2) into physics.ctrl of shape (3, 2)"
    ),
    "def apply(self, action): self.physics.ctrl = action": "physics.ctrl is the simulator's",
    "def layout(self): return [Part('all', 3, '')]": (
        "layout() names 3 numbers, but observe() gives 9"
    ),
    "def layout(self): return self.parts": "layout() fails: AttributeError",
    "load_model = classmethod(lambda cls: cls.model)": "load_model() fails: AttributeError",
    "load_model = classmethod(lambda cls: None)": "load_model() returns a NoneType, not a mujoco.M",
    "def vary_model(self, seed): return self.mass": "vary_model() fails: AttributeError",
    "def vary_model(self, seed): self.mass = 2": "has type NoneType and shape (): it must be a dic",
    "def vary_model(self, seed): return {'body_mas': np.ones((3, 4))}": "names body_mas, no array",
    "def vary_model(self, seed): return {'body_mass': np.ones(4)}": (
        "vary_model()['body_mass'] has type ndarray and shape (4,): it must be a NumPy array (3, 4)"
    ),
    "def vary_model(self, seed): return {'body_mass': np.ones((4, 4))}": "shape (4, 4): it must",
    "command_limits = {'m/s': (1, -1)}": "must have the lowest and the highest value of each",
    "command_limits = {'m/s': 1}": "must have the lowest and the highest value of each number",
    "command_limits = ['m/s']": "must have the lowest and the highest value of each number",
    "command_limits = {'m/s': (-1, 1)}": (
        "Crawler.command has type NoneType and shape (): it must be a tensor (3, 1)"
    ),
    "designs, load_model = {'arm': (1, 0, 2)}, classmethod(lambda cls: None)": (
        "model there, not in load_model"
    ),
    "del failed": "Crawler does not define failed, which every task needs.",
    "del model_file": "Crawler names no MJCF: give it a model_file.",
    "model_file = 'crawl.xml'": "MuJoCo cannot load",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_in_a_task_class_is_explained(folder, line):
    with (folder / "crawler.py").open("a") as file:
        file.write(f"\n    {line}\n")
    with pytest.raises(MorlaxError, match=re.escape(MISTAKES[line])):
        envs.make("crawler.py:Crawler", 3, "cpu")


@pytest.mark.parametrize("name", ["episode_length", "nconmax", "njmax"])
def test_an_option_that_a_task_declares_anew_keeps_its_bounds(folder, name):
    with pytest.raises(MorlaxError, match=rf"{name}: it must be at least 1 \(given: -5\)"):
        envs.make("crawler.py:Crawler", 3, "cpu", **{name: -5})


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
