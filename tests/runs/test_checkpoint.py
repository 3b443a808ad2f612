"""What a run's files may hold: everything else is refused in a sentence that names the file."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from tiny import learner, tiny

from morlax_torch import MorlaxError, load
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run
from morlax_torch.runs.loading import find_checkpoint
from morlax_torch.runs.progress import History
from morlax_torch.train import train

NAN = float("nan")


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    return train(tiny(), output=tmp_path_factory.mktemp("trained") / "run").folder


@pytest.fixture
def run(trained, tmp_path) -> Path:
    return shutil.copytree(trained, tmp_path / "run")


def edit(file: Path, *keys: Any, value: Any) -> None:
    contents = torch.load(file)
    place = contents
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    torch.save(contents, file)


def resume(run: Path) -> None:
    with Run.open(run) as opened:
        opened.restore(learner(opened.config()))


BAD_POLICIES = {
    "a NaN parameter": (("learner", "agent", "actor.bias"), torch.full((53,), NAN), "not finite"),
    "a huge size": (("environment", "action_size"), 2**40, "environment.action_size"),
    "no task": (("config", "env"), 7, "env must name the task"),
    "a NaN in the config": (("config", "ppo", "clip"), NAN, "ppo.clip: Input should be a finite"),
}


@pytest.mark.parametrize("damage", BAD_POLICIES)
def test_a_policy_is_not_loaded_from_wrong_contents(damage, run):
    keys, value, words = BAD_POLICIES[damage]
    file = run / "checkpoints" / "best.pt"
    edit(file, *keys, value=value)
    with pytest.raises(MorlaxError, match=words) as error:
        load(file)
    assert "best.pt" in str(error.value) and "\n" not in str(error.value)


BAD_STATES = {
    "a NaN position": (
        ("learner", "environment", "qpos"),
        torch.full((8, 7), NAN).double(),
        "not finite",
    ),
    "fewer worlds": (("learner", "environment", "qvel"), torch.zeros(1, 6), "instead of"),
    "an unknown moment": (("learner", "optimizers"), [torch.zeros(3)], "state.optimizers"),
    "a text": (("learner", "iteration"), "five", "state.iteration is 'five'"),
    "a NaN counter": (("progress", "train_seconds"), NAN, "progress.train_seconds"),
}


@pytest.mark.parametrize("damage", BAD_STATES)
def test_a_run_is_not_resumed_from_wrong_contents(damage, run):
    keys, value, words = BAD_STATES[damage]
    edit(run / "checkpoints" / "latest.pt", *keys, value=value)
    with pytest.raises(MorlaxError, match=words) as error:
        resume(run)
    assert "latest.pt" in str(error.value) and "\n" not in str(error.value)


def test_a_run_resumes_with_the_config_of_its_checkpoint(run):
    file = run / "config.yaml"
    edited = yaml.safe_load(file.read_text())
    edited["ppo"]["clip"], edited["network"]["actor"] = 0.5, [5]
    file.write_text(yaml.safe_dump(edited))
    words = r"ppo.clip: 0.5 instead of 0.2.*may change only max_env_steps"
    with pytest.raises(MorlaxError, match=rf"config.yaml was edited.*network.actor.*{words}"):
        Run.open(run).config()


def test_limits_and_evaluation_may_change_in_a_run_s_config(run):
    file = run / "config.yaml"
    edited = yaml.safe_load(file.read_text())
    edited["max_env_steps"], edited["evaluation"]["every"] = 128, 64
    file.write_text(yaml.safe_dump(edited))
    config = Run.open(run).config()
    assert (config.max_env_steps, config.evaluation.every) == (128, 64)
    config = config.model_copy(update={"max_env_steps": 96})
    assert train(config, Run.open(run)).folder == run
    assert yaml.safe_load(file.read_text())["max_env_steps"] == 96
    assert torch.load(run / "checkpoints" / "latest.pt")["learner"]["iteration"] == 3
    with pytest.raises(MorlaxError, match=r"keeps its config \(seed: 1 instead of 0\)"):
        train(config.model_copy(update={"seed": 1}), Run.open(run))


def test_a_run_may_have_unused_options_of_an_earlier_version(run):
    file = run / "config.yaml"
    edited = yaml.safe_load(file.read_text())
    edited["task"]["former"] = edited["former"] = None
    file.write_text(yaml.safe_dump(edited))
    for name in ("best", "latest"):
        edit(run / "checkpoints" / f"{name}.pt", "config", "task", "former", value=None)
    load(run)
    resume(run)
    edit(run / "checkpoints" / "best.pt", "config", "task", "former", value="former.pt")
    with pytest.raises(MorlaxError, match=r"best.pt does not fit: unknown task key 'former'"):
        load(run)


CURVES = {
    "no rows": lambda text: text.splitlines()[0],
    "a NaN": lambda text: text.replace(text.splitlines()[-1].split(",")[4], "nan"),
    "a word": lambda text: text.replace(text.splitlines()[-1].split(",")[1], "many"),
    "half a row": lambda text: text.rstrip()[:-40],
}


@pytest.mark.parametrize("damage", CURVES)
def test_a_damaged_training_curve_is_refused(damage, run):
    file = run / "metrics.csv"
    file.write_text(CURVES[damage](file.read_text()))
    for use in (lambda: History.load(file), lambda: resume(run)):
        with pytest.raises(MorlaxError, match=r"metrics.csv is damaged"):
            use()


FRONTS = {
    "a NaN": ({"returns": np.full((4, 2), NAN)}, "returns must hold finite numbers"),
    "text": ({"lengths": np.array(["a"] * 4)}, r"lengths must hold finite numbers of shape \(4,\)"),
    "no trade-off": ({"tradeoffs": np.zeros((4, 2))}, "a weight above zero"),
    "markup": ({"objectives": np.array(["run", "<b>"])}, "name of an objective"),
}


@pytest.mark.parametrize("damage", FRONTS)
def test_a_front_with_wrong_contents_is_refused(damage, run):
    changes, words = FRONTS[damage]
    file = run / "front.npz"
    with np.load(file) as arrays:
        contents = {**arrays, **changes}
    np.savez(file, **contents)
    with pytest.raises(MorlaxError, match=f"front.npz is damaged or not a front: .*{words}"):
        Front.load(file)


def test_a_part_that_claims_to_be_a_folder_is_damage(run):
    """PyTorch would return memory that nobody has written; no checksum covers this bit."""
    file = run / "checkpoints" / "best.pt"
    data = bytearray(file.read_bytes())
    name = data.rindex(b"/data/0")  # of the last list of parts; 46 bytes of header come before
    start = data.rindex(b"PK\1\2", 0, name)
    data[start + 38] ^= 0x10
    file.write_bytes(data)
    with pytest.raises(MorlaxError, match=r"best.pt is damaged"):
        load(file)


def test_the_newest_checkpoint_of_rsl_rl_is_found_by_its_number(tmp_path):
    for name in ("model_9.pt", "model_0010.pt", "model_best.pt"):
        (tmp_path / name).touch()
    assert find_checkpoint(tmp_path).name == "model_0010.pt"
