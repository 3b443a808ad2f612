"""Exported policies act like the original in every format, and their files hold a manifest."""

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from tiny import learner, tiny
from torch import Tensor, nn

from morlax_torch import MorlaxError, Policy, envs, save
from morlax_torch.commands import export
from morlax_torch.exports.exporting import FORMATS, Format, actuators, control, manifest
from morlax_torch.exports.exporting import export as export_run
from morlax_torch.runs import checkpoint, loading
from morlax_torch.runs.progress import Progress

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.*treespec:FutureWarning"),
]


@pytest.fixture
def trained(make_policy) -> Callable[..., Policy]:
    """Return a factory of policies whose observation normalizer has been updated."""

    def make(task: str = "hopper") -> Policy:
        found = make_policy(task)
        noise = torch.randn(100, found.agent.observation_size)
        found.agent.observation_normalizer.update(3.0 + 5.0 * noise)
        return found

    return make


def run(format: str, data: bytes, *inputs: Tensor) -> Tensor:
    """Return the actions of a file, read by the library that users read it with."""
    if format == "torchscript":
        return torch.jit.load(io.BytesIO(data))(*inputs)
    if format == "torch-export":
        return torch.export.load(io.BytesIO(data)).module()(*inputs)
    onnx.checker.check_model(onnx.load_from_string(data), full_check=True)
    session = onnxruntime.InferenceSession(data)
    names = [value.name for value in session.get_inputs()]
    arrays = dict(zip(names, (value.numpy() for value in inputs), strict=True))
    return torch.from_numpy(session.run(["action"], arrays)[0])


def metadata(format: str, data: bytes) -> dict:
    """Return the manifest stored in an exported file."""
    if format == "onnx":
        props = onnx.load_from_string(data).metadata_props
        return {prop.key: json.loads(prop.value) for prop in props}
    files = {"morlax_torch.json": ""}
    if format == "torchscript":
        torch.jit.load(io.BytesIO(data), _extra_files=files)
    else:
        torch.export.load(io.BytesIO(data), extra_files=files)
    return json.loads(files["morlax_torch.json"])


def inputs(found: Policy, rows: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    size, m = found.agent.observation_size, len(found.objectives)
    observation = 3.0 + 5.0 * torch.randn(rows, size, generator=generator)
    return observation, torch.rand(m, generator=generator) + 0.01


@pytest.mark.parametrize("format", FORMATS)
def test_a_single_policy_matches_for_any_number_of_rows(format, trained, generator, tmp_path):
    found, tradeoff = trained("cheetah3"), (0.5, 0.2, 0.3)
    with torch.device("meta"):  # as a user's default
        largest = export_run(found, tmp_path / "it", format, np.array(tradeoff, np.float32))
    assert 0 <= largest < 1e-5
    data = (tmp_path / "it").read_bytes()
    for rows in (1, 2, 33):
        observation, _ = inputs(found, rows, generator)
        action = run(format, data, observation)
        torch.testing.assert_close(action, found(observation, tradeoff), atol=1e-5, rtol=0)
    assert action.std(0).min() > 1e-3


@pytest.mark.parametrize("format", FORMATS)
def test_a_family_takes_the_tradeoff_as_an_input(format, trained, generator, tmp_path):
    found = trained()
    export_run(found, tmp_path / "it", format)
    data = (tmp_path / "it").read_bytes()
    for rows in (1, 2, 33):
        observation, tradeoff = inputs(found, rows, generator)
        action = run(format, data, observation, tradeoff)
        torch.testing.assert_close(action, found(observation, tradeoff), atol=1e-5, rtol=0)
    assert not torch.allclose(action, found(observation, tradeoff.flip(0)), atol=1e-3)
    if format == "onnx":
        session = onnxruntime.InferenceSession(data)
        shapes = {x.name: x.shape for x in (*session.get_inputs(), *session.get_outputs())}
        assert shapes == {"observation": ["batch", 13], "tradeoff": [2], "action": ["batch", 4]}


@pytest.mark.parametrize("format", ["torchscript", "torch-export"])
def test_a_file_holds_the_manifest(format, trained, tmp_path):
    found = trained("hopper")
    export_run(found, tmp_path / "it", format, (0.7, 0.3), {"run": {"seed": 3}})
    about = metadata(format, (tmp_path / "it").read_bytes())
    assert about == json.loads(json.dumps({**manifest(found, (0.7, 0.3)), "run": {"seed": 3}}))
    assert (about["task"], about["objectives"]) == ("hopper", ["run", "jump"])
    assert about["tradeoff"] == [0.7, 0.3]
    assert about["control_rate_hz"] == 100
    assert (about["observation_size"], about["action_size"]) == (13, 4)
    assert about["observation"][0] == {"name": "position.rootz", "slice": [0, 1], "unit": "m"}
    assert about["observation"][-1]["slice"] == [12, 13]
    knee = {"name": "knee", "joint": "knee", "gear": 30.0, "control_range": None}
    assert about["actuators"][2] == knee


@pytest.mark.parametrize("task", [name for name in envs.names() if name != "bruce"])
def test_the_manifest_s_mapping_from_action_to_control_is_correct(task, generator):
    env = envs.make(task, 50, "cpu")
    found = control(envs.make(task, 1, "cpu"))
    scale, offset, low, high = (np.array(found[n]) for n in ("scale", "offset", "low", "high"))
    action = torch.rand(50, env.action_size, generator=generator) * 2 - 1
    env.apply(action)
    expected = np.clip(offset + scale * action.numpy(), low, high)
    np.testing.assert_allclose(env.physics.ctrl.numpy(), expected, atol=1e-6)
    model, data = env.physics.model, mujoco.MjData(env.physics.model)
    for index, actuator in enumerate(actuators(env) if task == "ant" else ()):
        data.ctrl[:] = 0
        data.ctrl[index] = 0.5
        mujoco.mj_forward(model, data)
        (dof,) = np.flatnonzero(data.qfrc_actuator)
        assert actuator["joint"] == model.joint(model.dof_jntid[dof]).name
        assert data.qfrc_actuator[dof] == pytest.approx(0.5 * actuator["gear"])


def test_control_that_is_not_clipped_linear_is_omitted(monkeypatch):
    bruce = envs.make("bruce", 1, "cpu")  # whose actions pass a filter, and move the reference
    assert control(bruce) is None and actuators(bruce) == []
    env = envs.make("hopper", 1, "cpu")
    monkeypatch.setattr(env, "apply", lambda action: env.physics.ctrl.copy_(action.pow(3)))
    assert control(env) is None
    turned = env.physics.qpos[:, 3:7]  # targets of servos relative to where their joints are
    monkeypatch.setattr(env, "apply", lambda action: env.physics.ctrl.copy_(turned + 0.1 * action))
    assert control(env) is None
    monkeypatch.setattr(env, "apply", lambda action: env.physics.ctrl.copy_(0.5 - 2 * action))
    expected = {"scale": -2.0, "offset": 0.5, "low": -1.5, "high": 2.5}
    assert control(env) == {name: [value] * 4 for name, value in expected.items()}


def test_a_gear_with_directions_has_all_its_numbers():
    xml = """<mujoco><worldbody><body><joint type="ball" name="neck"/><geom size=".1"/>
      <site name="rotor"/></body></worldbody><actuator><motor joint="neck" gear="0 5 0"/>
      <motor site="rotor" gear="0 0 1 0 0 .02"/><motor joint="neck" gear="3"/></actuator>
      </mujoco>"""
    env = envs.make("hopper", 1, "cpu")
    env.action_size, env.physics.model = 3, mujoco.MjModel.from_xml_string(xml)
    described = actuators(env)
    assert [each["gear"] for each in described] == [[0, 5, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0.02], 3]
    assert [each["joint"] for each in described] == ["neck", None, "neck"]
    if hasattr(env.physics.model, "nactuator"):  # MuJoCo 4: an actuator may have several controls
        turning = xml.replace('<motor joint="neck" gear="3"/>', '<orientation joint="neck"/>')
        env.action_size, env.physics.model = 5, mujoco.MjModel.from_xml_string(turning)
        assert actuators(env) == []


OWN = nn.Sequential(nn.Linear(13, 16), nn.LayerNorm(16), nn.ELU(), nn.Linear(16, 8))
CONDITIONED = {"network.type": "conditioned"}


@pytest.mark.parametrize(
    ("changes", "actor", "format", "tradeoff"),
    [
        ({}, OWN, "onnx", None),
        (CONDITIONED, None, "onnx", None),
        (CONDITIONED, None, "torchscript", (0.2, 0.8)),
    ],
)
@pytest.mark.slow
def test_other_networks_can_be_exported(changes, actor, format, tradeoff, generator, tmp_path):
    morlax = learner(tiny(**changes), actor=actor)
    found = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    for parameter in morlax.agent.actor.parameters():
        nn.init.normal_(parameter, std=0.2, generator=generator)
    export_run(found, tmp_path / "it", format, tradeoff)
    seen, weights = inputs(found, 5, generator)
    given = (seen,) if tradeoff else (seen, weights)
    action = run(format, (tmp_path / "it").read_bytes(), *given)
    torch.testing.assert_close(action, found(seen, tradeoff or weights), atol=1e-5, rtol=0)


def test_a_file_that_acts_differently_is_not_written(trained, tmp_path, monkeypatch):
    usual = FORMATS["torchscript"]
    wrong = Format(".ts", usual.write, lambda data: lambda *given: usual.read(data)(*given) + 2e-5)
    monkeypatch.setitem(FORMATS, "torchscript", wrong)
    with pytest.raises(MorlaxError, match=r"differ from the policy.s by up to 2\.0e-05"):
        export_run(trained(), tmp_path / "it.ts", "torchscript")
    with pytest.raises(MorlaxError, match=r"unknown format 'onxx': did you mean 'onnx'"):
        export_run(trained(), tmp_path / "policy", "onxx")
    assert not list(tmp_path.iterdir())


def test_autocast_of_a_user_changes_no_file(trained, tmp_path):
    with torch.autocast("cpu", torch.bfloat16):
        export_run(trained(), tmp_path / "family.ts", "torchscript")


class Stateful(nn.Linear):
    """A layer that begins with a state of zeros for each row, as a GRUCell does."""

    def forward(self, input: Tensor) -> Tensor:
        return super().forward(input) + torch.zeros(input.shape[0], self.out_features)


def test_a_network_that_torchscript_cannot_represent_is_refused(tmp_path):
    morlax = learner(tiny(), actor=Stateful(13, 8))
    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    export_run(policy, tmp_path / "it.pt2", "torch-export")
    with pytest.raises(MorlaxError, match=r"torchscript cannot represent .*: try another --format"):
        export_run(policy, tmp_path / "it.ts", "torchscript")


@pytest.fixture
def saved(trained, workplace: Path) -> Path:
    """Save policy.pt and the metrics of its run in the working directory."""
    save(trained(), workplace / "policy.pt")
    (workplace / "metrics.csv").write_text(
        "iteration,env_steps,train_seconds,hypervolume,best\n0,0,0,5,1\n1,10,1,7.5,1\n2,20,2,6,0\n"
    )
    return workplace


def test_the_default_output_is_beside_the_policy_and_describes_its_run(saved, capsys):
    export.command(["policy.pt", "--tradeoff", "7,3"])
    assert "written: policy.onnx (largest difference from the policy: " in capsys.readouterr().out
    about = metadata("onnx", (saved / "policy.onnx").read_bytes())
    assert about["tradeoff"] == [7, 3] and about["control_rate_hz"] == 100
    assert about["run"]["best_hypervolume"] == 7.5
    assert len(about["run"]["sha256"]) == 64


@pytest.mark.parametrize(
    ("format", "name"), [("torchscript", "family.ts"), ("torch-export", "family.pt2")]
)
def test_a_shipped_policy_is_exported_into_the_working_directory(saved, format, name, monkeypatch):
    monkeypatch.setattr(loading, "SHIPPED", saved / "shipped")
    folder = saved / "shipped" / "hopper"
    (folder / "checkpoints").mkdir(parents=True)
    (saved / "policy.pt").rename(folder / "checkpoints" / "best.pt")
    export.command(["hopper", "--format", format])
    about = metadata(format, (saved / name).read_bytes())
    assert about["task"] == "hopper" and about["tradeoff"] is None
    assert not (folder / name).exists()


def test_a_mistake_prints_one_error_and_writes_nothing(saved, refused):
    assert "nowhere does not exist" in refused(export, "nowhere")
    weights = refused(export, "policy.pt", "--tradeoff", "-1,2")
    assert "must be finite, not negative" in weights
    output = ("--format", "torchscript", "--output", "policy.pt/a.ts")
    assert "add --format torchscript" in refused(export, "policy.pt", "--output", "policy.ts")
    assert "cannot make policy.pt: File exists" in refused(export, "policy.pt", *output)
    actor = nn.Sequential(nn.Linear(13, 8))
    checkpoint.write(
        saved / "own.pt", checkpoint.snapshot(learner(tiny(), actor=actor)), Progress()
    )
    text = refused(export, saved / "own.pt")
    assert "holds a user-made actor, which no config describes" in text


def test_a_missing_package_names_the_extra(saved, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    text = refused(export, "policy.pt")
    assert "ONNX needs onnxscript" in text and "pip install 'morlax-torch[onnx]'" in text
