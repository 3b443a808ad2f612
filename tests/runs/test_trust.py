"""A run's files execute no code by themselves."""

import shutil
from pathlib import Path

import pytest
from tiny import tiny

from morlax_torch import MorlaxError, envs, load
from morlax_torch.__main__ import command
from morlax_torch.configuration.config import Config
from morlax_torch.runs import Run, checkpoint
from morlax_torch.runs.references import NAMES_CODE
from morlax_torch.train import train

PAYLOAD = """
from pathlib import Path
from morlax_torch import envs
Path({!r}).touch()
class Robot(envs.get("hopper")):
    pass
"""


@pytest.fixture
def hostile(workplace: Path, make_run) -> Path:
    """A run whose task is a Python file that leaves a trace when it runs."""
    robot = workplace / "robot.py"
    robot.write_text(PAYLOAD.format(str(workplace / "sprung")))
    run = make_run(workplace / "run", "hopper", "best", "latest", env=f"{robot}:Robot")
    (run / "config.yaml").write_text(f"env: {robot}:Robot\n")
    return run


COMMANDS = {
    "evaluate": ("run", "--device", "cpu"),
    "record": ("run",),
    "export": ("run",),
    "explore": ("run", "--port", "0"),
    "pack": ("run", "packed", "--device", "cpu"),
    "train": ("--resume", "run", "--device", "cpu"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_runs_code_that_only_a_file_names(hostile, name):
    with pytest.raises(MorlaxError, match=r"would run the code of .*robot.py:Robot.*--trust"):
        command([name, *COMMANDS[name]])
    assert not Path("sprung").exists()


@pytest.fixture
def hostile_copy(hostile) -> Path:
    """A run whose own copy of a harmless task that the user trusts leaves a trace when it runs."""
    robot = hostile.parent / "robot.py"
    (hostile / "task").mkdir()
    shutil.copy(robot, hostile / "task")
    robot.write_text(robot.read_text().replace(".touch()", ""))
    envs.get(f"{robot}:Robot")
    return hostile


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("original", ["edited", "missing"])
@pytest.mark.filterwarnings("ignore:.*is not as it was:UserWarning")
def test_no_command_runs_a_copy_in_a_run_because_its_original_is_trusted(
    name, original, hostile_copy
):
    if original == "missing":
        Path("robot.py").unlink()
    with pytest.raises(MorlaxError, match=r"would run the code of .*task/robot.py:Robot.*--trust"):
        command([name, *COMMANDS[name]])
    assert not Path("sprung").exists()
    if name == "train":
        command(["evaluate", "run", "--device", "cpu", "--trust", "--tradeoffs", "4"])
        assert Path("sprung").exists()


def test_a_module_of_gymnasium_is_code_too_and_a_registered_id_is_not():
    with pytest.raises(MorlaxError, match="would run the code of gymnasium:antigravity:Fly-v0"):
        envs.check_trusted("gymnasium:antigravity:Fly-v0", "run.pt")
    with pytest.raises(MorlaxError, match="if you trust it"):
        envs.check_trusted("mjlab:my_tasks:Mine", "a file")
    for name in ("gymnasium:mo-hopper-v5", "mjlab:Mjlab-Velocity-Flat-Unitree-Go1", "hopper"):
        envs.check_trusted(name, "run.pt")


def test_a_utility_travels_with_its_run(tmp_path):
    utility = tmp_path / "utility.py"
    utility.write_text("def best(tradeoffs, returns): return (tradeoffs * returns).sum(-1)\n")
    train(tiny(scalarization=f"{utility}:best"), output=tmp_path / "run")
    utility.unlink()
    copy = tmp_path.resolve() / "run" / "utility" / "utility.py"
    with pytest.raises(MorlaxError, match=f"would run the code of {copy}:best"):
        load(tmp_path / "run")
    run = Run.open(tmp_path / "run")
    config = run.config(trust=True)
    assert config.scalarization == load(run.folder).config.scalarization == f"{copy}:best"
    train(config.model_copy(update={"max_env_steps": 96}), run)
    moved = copy.rename(tmp_path / "utility.py")
    changes = {"max_env_steps": 128, "scalarization": f"{moved}:best"}
    train(config.model_copy(update=changes), Run.open(run.folder))
    assert checkpoint.load(run.checkpoints / "latest.pt").progress.env_steps == 128


def test_every_field_that_can_name_a_file_needs_trust():
    described = {name: field.description or "" for name, field in Config.model_fields.items()}
    assert set(NAMES_CODE) == {name for name, text in described.items() if "FILE.py" in text}


def test_a_command_line_that_names_the_code_allows_it(hostile):
    """It runs the robot's code, and then finds that the run cannot be continued."""
    with pytest.raises(MorlaxError, match="was edited since the run began"):
        command(["train", "--resume", "run", "--device", "cpu", "--env", "robot.py:Robot"])
    assert Path("sprung").exists()
