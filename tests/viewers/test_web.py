"""The web page's graphs and models are those of the tasks, and mistakes are explained."""

import io
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
import web_robots

from morlax_torch import MorlaxError, envs
from morlax_torch.envs import Environment
from morlax_torch.envs.registry import get
from morlax_torch.viewers import libraries
from morlax_torch.viewers.player import Player
from morlax_torch.viewers.web.tracing import ARRAYS, PagePhysics, trace
from morlax_torch.viewers.web.writing import build, compiled, described, start

pytest.importorskip("onnxscript", reason="the extra [onnx] is not installed")
InferenceSession = pytest.importorskip("onnxruntime").InferenceSession
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("ant", "humanoid")]
LONG = pytest.param("bruce", marks=[pytest.mark.slow, pytest.mark.long])


def world(name: str, **options) -> Environment:
    task = get(name)
    chosen = task.Options.model_validate(options)
    physics = PagePhysics(task.compile_model(chosen), task.substeps)
    return task(physics, chosen, 0, auto_reset=False)


@pytest.fixture
def robots(tmp_path: Path) -> str:
    file = web_robots.write(tmp_path / "robots")
    for name in ("Tumbler", "Carried", "Counting", "Deciding", "Shuffled"):
        envs.trust(f"{file}:{name}")
    return file


@pytest.mark.parametrize("name", [*SLOW, LONG])
def test_graphs_step_like_the_task(name):
    trace(world(name))  # which compares them


def test_a_page_moves_mocap_bodies_and_applies_forces_as_the_task_does(robots):
    env = world(f"{robots}:Carried")
    traced = trace(env)
    run = {"action": np.float32([0.5])} | {k: x.numpy().copy() for k, x in traced.state.items()}
    env.step(torch.tensor([[0.5]]))
    for graph in (traced.before, traced.after):
        inputs = {name: run[name] for name in graph.inputs}
        results = InferenceSession(graph.onnx).run(None, inputs)
        run.update(zip(graph.outputs, results, strict=True))
    for name in ("xfrc_applied", "mocap_pos"):  # which the page writes into mjData
        np.testing.assert_allclose(run[name], env.physics.part(ARRAYS[name]).numpy().ravel())
    assert run["xfrc_applied"][8] == 105 and run["mocap_pos"][2] > 0
    _, model = compiled(type(env), env.options)
    starts = described(env, traced, model)["starts"]
    assert len({start["mocap_pos"][0] for start in starts}) == 16  # an episode draws its goal


@pytest.mark.slow
def test_graphs_step_with_the_same_noise_delays_and_pushes():
    noise = {"observation_noise": {"position": 0.1}, "action_delay": (1, 3)}
    pushes = {"push": 0.5, "push_every": 3}
    traced = trace(world("hopper", randomization={**noise, **pushes}, reset_noise=0.01))
    kinds = [draw["kind"] for graph in traced[:2] for draw in graph.draws.values()]
    assert kinds == ["normal", "uniform", "normal"]


@pytest.mark.parametrize(
    ("task", "reason"),
    [
        ("Deciding", "into Python"),
        ("Shuffled", "bernoulli"),
        ("Counting", "keep all state in tensors"),
    ],
)
@pytest.mark.slow
def test_tasks_that_no_graph_can_express_are_refused(robots, task, reason):
    with pytest.raises(MorlaxError, match=f"{task} cannot run in a browser: .*{reason}"):
        trace(world(f"{robots}:{task}"))


@pytest.mark.parametrize("name", ["bruce", "humanoid", "mo-gymnasium/humanoid", "Tumbler"])
def test_the_model_survives_as_text(name, robots):
    task = get(f"{robots}:{name}" if name == "Tumbler" else name)
    model, web = compiled(task, task.Options())
    again = mujoco.MjModel.from_xml_string(web.xml, web.assets)
    for field, numbers in web.fields.items():
        getattr(again, field).flat = numbers
    np.testing.assert_array_equal(model.mesh_vert, again.mesh_vert)
    assert (name == "Tumbler") == (list(web.assets) == ["asset-0.stl"])
    datas = [mujoco.MjData(x) for x in (model, again)]
    for data, own in zip(datas, (model, again), strict=True):
        mujoco.mj_step(own, data, 100)
    np.testing.assert_array_equal(datas[0].qpos, datas[1].qpos)


def test_a_page_shows_the_nominal_robot_of_a_mujoco_task(make_policy):
    policy = make_policy("hopper", task={"randomization": {"mass": [2.0, 3.0]}})
    env, _ = build(policy)
    np.testing.assert_array_equal(env.physics.model.body_mass, get("hopper").load_model().body_mass)
    policy.config = policy.config.model_copy(update={"env": "gymnasium:mo-hopper-v5"})
    with pytest.raises(MorlaxError, match="only MuJoCo robots"):
        build(policy)


def test_the_recorded_start_is_the_robot_with_even_weights(make_policy):
    policy = make_policy("hopper")
    recorded = read_arrays(start(policy))
    player = Player(policy, (0.5, 0.5))
    model, dt = player.model, player.env.dt
    assert 0.015 < recorded["dt"] < 0.025 and recorded["followed"] == 1
    places = recorded["places"].reshape(-1, model.nbody, 3)
    turns = recorded["turns"].reshape(-1, model.nbody, 4)
    for place, turn in zip(places, turns, strict=True):
        np.testing.assert_array_equal(place, player.data.xpos.astype(np.float32))
        np.testing.assert_array_equal(turn, player.data.xquat.astype(np.float32))
        for _ in range(round(recorded["dt"] / dt)):
            if not player.over:
                player.step()
    assert player.over and len(places) > 3
    np.testing.assert_array_equal(recorded["geom_type"], model.geom_type)


def read_arrays(data: bytes) -> dict[str, Any]:
    """Read what `model_bytes` returned, as the page does."""
    begin = 4 + int(np.frombuffer(data, np.int32, 1)[0])
    found = json.loads(data[4:begin])
    for name, (kind, at, size) in found.pop("arrays").items():
        found[name] = np.frombuffer(data, kind, size, begin + at)
    return found


def test_a_changed_download_is_refused_and_not_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: io.BytesIO(b"other"))
    with pytest.raises(MorlaxError, match="SHA-512"):
        libraries.files()
    assert not list(tmp_path.rglob("*.tgz"))
