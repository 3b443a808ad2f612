"""`morlax new` writes tasks that train at once; `morlax` alone names commands that work here."""

import ctypes
import re
import shlex
import shutil
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest
import torch
from tiny import TYPED

from morlax_torch import __main__, envs
from morlax_torch.__main__ import command
from morlax_torch.commands import new, train
from morlax_torch.envs.errors import MorlaxWarning
from morlax_torch.evaluation.front import Front
from morlax_torch.host.machine import gpu

ARM = Path(__file__).parents[2] / "docs" / "examples" / "two_goals.xml"
WALKER = """
<mujoco>
  <worldbody>
    {floor}
    <body {name} pos="0 0 0.4">
      {root}
      <geom type="box" size="0.2 0.1 0.05" mass="2"/>
      <body>
        <joint name="hip" axis="0 1 0"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.35"/>
      </body>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
  <sensor><gyro site="imu" name="gyro"/></sensor>
</mujoco>
"""
PARTS = {
    "name": 'name="trunk"',
    "floor": '<geom type="plane" size="0 0 1"/>',
    "root": '<freejoint/><site name="imu"/>',
    "actuator": '<motor joint="hip" ctrlrange="-9 5"/>',
}


@pytest.fixture
def folder(workplace: Path) -> Path:
    """The working directory, with an arm and a walker whose actuator has no name."""
    shutil.copy(ARM, workplace / "arm.xml")
    (workplace / "my-walker.xml").write_text(WALKER.format(**PARTS))
    return workplace


@pytest.fixture
def walker(folder) -> envs.Environment:
    new.command(["my-walker.xml"])
    return envs.make("my-walker.py:MyWalker", 3, "cpu", auto_reset=False)


@pytest.fixture
def arm(folder) -> envs.Environment:
    new.command(["arm.xml"])
    return envs.make("arm.py:Arm", 3, "cpu", auto_reset=False)


@pytest.mark.parametrize(
    ("file", "objectives"),
    [("arm.xml", ("reach", "energy")), ("my-walker.xml", ("speed", "energy"))],
)
def test_the_printed_command_trains_the_written_task(file, objectives, folder, capsys):
    new.command([file])
    written, line = capsys.readouterr().out.splitlines()
    assert written.startswith(f"written: {Path(file).stem}.py")
    arguments = shlex.split(line.partition(" train ")[2])
    command(["train", *arguments, *TYPED, "--output", "run"])
    assert Front.load("run/front.npz").objectives == objectives
    assert (folder / "run" / "task" / file).is_file()


def test_a_walker_is_rewarded_for_speed_and_rest_until_it_falls(walker):
    walker.physics.qvel[0, 0] = 2.0
    walker.physics.qpos[1, 2], walker.physics.qpos[1, 7] = 0.15, 1.5  # on its belly, the leg ahead
    walker.physics.qpos[2, 3:7] = torch.tensor([0.0, 1.0, 0.0, 0.0])  # upside down
    step = walker.step(torch.zeros(3, 1))
    assert step.terms["speed"][0] == pytest.approx(2.0, abs=0.3)
    assert step.terminated.tolist() == [False, True, True]
    assert walker.physics.ctrl[0, 0] == -2.0  # the middle of its range
    walker.reset()
    push, rest = (walker.step(torch.full((3, 1), value)).terms["energy"] for value in (1.0, 0.0))
    assert (push < rest).all()


def test_a_walker_observes_all_but_its_place_and_names_it(walker):
    before = walker.observe().clone()
    walker.physics.qpos[:, :2] += 5.0
    assert torch.equal(walker.observe(), before)
    names = [part.name for part in walker.layout()]
    assert names[0] == "position..z" and names[-1] == "sensors"
    assert walker.layout()[-1].size == 3  # those of the gyro


def test_an_arm_holds_its_pose_and_reaches_for_targets_that_change(arm):
    targets = []
    for _ in range(101):
        targets.append(arm.physics.part("mocap_pos")[:, 0].clone())
        step = arm.step(torch.zeros(3, 2))
    start = torch.as_tensor(arm.initial_qpos())
    assert (arm.physics.qpos - start).abs().max() < 0.1
    changed = [bool((a != b).any()) for a, b in pairwise(targets)]
    assert changed.index(True) == 99 and changed.count(True) == 1
    assert (targets[0].norm(dim=-1) < 0.5).all()  # the length of the arm
    near = arm.error().norm(dim=-1).argsort()
    assert torch.equal(step.terms["reach"].argsort(descending=True), near)


PULLED = """
<intvelocity name="🦿" tendon="pull" kp="9" actrange="-1 1"/></actuator>
<tendon><fixed name="pull"><joint joint="hip" coef="1"/></fixed></tendon>
<keyframe><key name="home" qpos="0 0 0.5"/></keyframe><actuator>
"""


def test_a_planar_walker_with_tendons_runs_and_controls_of_speed_hold_no_pose(folder):
    slides = '<joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/><site name="imu"/>'
    Path("odd.xml").write_text(WALKER.format(**PARTS | {"root": slides, "actuator": PULLED}))
    new.command(["odd.xml"])
    robot = envs.make("odd.py:Odd", 3, "cpu")
    assert robot.objectives == ("speed", "energy")
    robot.step(torch.zeros(3, 1))
    assert (robot.physics.ctrl == 0).all()


PID = '<pid joint="hip" input="pos vel" kp="9" kv="1"/>'
MUJOCO_4 = pytest.mark.skipif(not hasattr(mujoco.MjModel, "nactuator"), reason="needs MuJoCo 4")


@pytest.mark.parametrize(
    ("part", "text", "words"),
    [
        ("actuator", "", "has no actuators: add them for its joints, .*<motor"),
        pytest.param("actuator", PID, "has actuators with several controls", marks=MUJOCO_4),
        ("floor", "", "has no floor: name a scene that has one, or add <geom"),
        ("name", "", "body 1 of odd.xml is rewarded: name it"),
        ("root", "<freejoint", "MuJoCo cannot load odd.xml: .*[Ll]ine"),
    ],
)
def test_models_that_cannot_be_trained_are_refused(part, text, words, folder, refused):
    Path("odd.xml").write_text(WALKER.format(**PARTS | {part: text}))
    assert re.search(words, refused(new, "odd.xml"))


def test_a_robot_without_a_task_and_a_urdf_are_told_what_to_write(folder, refused):
    text = refused(train, "--env", "my-walker.xml", *TYPED)
    assert "a robot without a task: `morlax new my-walker.xml` writes" in text
    Path("link.urdf").write_text('<robot name="link"><link name="base"/></robot>')
    assert "no actuators: save it as an MJCF, mujoco.MjSpec" in refused(new, "link.urdf")


def test_a_robot_that_blows_up_is_reported(folder):
    violent = WALKER.format(**PARTS | {"actuator": '<velocity joint="hip" kv="1e4"/>'})
    Path("violent.xml").write_text(violent)
    with pytest.warns(MorlaxWarning, match=r"unstable.*use a smaller time step"):
        new.command(["violent.xml"])
    assert not Path("MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize("name", ["platform", "torch"])
def test_no_file_hides_a_module_that_commands_import(name, folder, refused):
    shutil.move("arm.xml", f"{name}.xml")
    assert f"{name}.py would hide the module {name}" in refused(new, f"{name}.xml")


@pytest.mark.parametrize("name", ["part", "POWER"])
def test_no_class_hides_a_name_that_its_file_uses(name, folder):
    shutil.move("arm.xml", f"{name}.xml")
    new.command([f"{name}.xml"])
    assert envs.make(f"{name}.py:Robot{name[0].upper()}{name[1:]}", 2, "cpu").action_size == 2


def test_no_file_is_overwritten(folder, refused):
    Path("arm.py").write_text("mine")
    assert "arm.py exists already: name another file with --output" in refused(new, "arm.xml")
    new.command(["arm.xml", "--output", "2 arms.py"])
    assert envs.get("2 arms.py:Robot2Arms").model_file == "arm.xml"


def printed(capsys) -> list[list[str]]:
    """Return the words of the four commands that `morlax` alone prints."""
    command([])
    first, rest = capsys.readouterr().out.partition("To begin with")[2].split("All commands:")
    assert all(f"  {name}" in rest for name in __main__.COMMANDS)
    lines = [line.strip() for line in first.splitlines() if line.startswith("  ")]
    return [shlex.split(line.partition("morlax ")[2]) for line in lines[::2]]


def test_morlax_alone_prints_commands_that_work_here(folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "orig_argv", ["morlax"])
    explored, trained, chosen, drafted = printed(capsys)
    assert explored == ["explore", "ant"]
    assert train.read([*trained[1:], "--device", "cpu"])[0].env == "cheetah"
    assert chosen[0] == "choose"
    assert drafted[0] == "new" and drafted[1] in ("arm.xml", "my-walker.xml")
    command([*drafted, "--output", "drafted.py"])


def test_morlax_alone_names_the_newest_run_and_the_gpu(folder, monkeypatch, capsys, make_run):
    def name_of(name: ctypes.Array, size: int, device: int) -> int:
        name.value = b"NVIDIA H200"
        return 0

    driver = SimpleNamespace(cuInit=lambda flags: 0, cuDeviceGetName=name_of)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: driver)
    assert gpu() == "NVIDIA H200"
    run = make_run(folder / "runs" / "cheetah" / "now", "cheetah", "best")
    (run / "config.yaml").write_text("env: cheetah\n")
    _, trained, used, _ = printed(capsys)
    assert trained[-2:] == ["--max-seconds", "10"] and used == ["explore", "latest"]
    (run / "config.yaml").write_text("env: /robots/arm.py:Arm\n")
    assert printed(capsys)[2] == ["explore", "latest", "--trust"]


def test_morlax_alone_says_what_to_install(folder, monkeypatch, capsys):
    monkeypatch.setattr(__main__, "find_spec", lambda name: None)
    command([])
    text = capsys.readouterr().out
    assert "explore ant\n    needs pip install 'morlax-torch[explore]'" in text
    assert "a machine without a CUDA GPU" in text
