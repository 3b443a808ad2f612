"""The shipped Go1 and G1s, exported from mjlab, walk in C MuJoCo as in mjlab."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from calm import calm
from tiny import FEW, tiny

from morlax_torch import envs, load
from morlax_torch.commands import export
from morlax_torch.envs.bridges.mjlab import worlds
from morlax_torch.train import train
from morlax_torch.viewers.player import Player
from morlax_torch.viewers.playing.episodes import Policy, run, summary
from morlax_torch.viewers.playing.robot import Disturbances, Robot, open_export
from morlax_torch.viewers.playing.tour import tour

pytest.importorskip("mjlab", reason="needs the extra mjlab")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")


GO1 = "mjlab:Mjlab-Velocity-Flat-Unitree-Go1"
NAMES = "go1", "g1", "g1-tour"


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """Return a folder with a folder for each shipped policy's export."""
    folder = tmp_path_factory.mktemp("exported")
    for name in NAMES:
        export.command([name, "--slew", "0.5", "--output", str(folder / name / "family.onnx")])
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_every_step_equals_one_of_mjlab(exported, name):
    deployment, command = open_export(exported / name), np.array([0.6, 0.2, -0.3])
    config = load(name, "cpu").config
    env = calm(config.env, 1, edit=lambda cfg: cfg.actions.pop("harness", None))
    entity, robot = env.scene["robot"], Robot(deployment)
    entity.set_joint_position_target(entity.data.default_joint_pos)  # `play` holds the arms, too
    env.command_manager.get_term("twist").command.copy_(torch.tensor(command)[None])
    seen = env.observation_manager.compute_group("actor")
    ours, theirs = Policy(deployment), Policy(deployment)
    assert env.observation_manager.active_terms["actor"][0] == "base_lin_vel"
    first = 3  # without it: no sensor measures it
    for _ in range(50):
        reference, observation = seen[0, first:].numpy(), robot.observe(command)
        np.testing.assert_allclose(observation, reference, rtol=0, atol=1e-3)
        action, expected = ours.act(observation), theirs.act(reference)
        np.testing.assert_allclose(action, expected, rtol=0, atol=1e-4)
        robot.step(action)
        groups, *_ = env.step(torch.tensor(config.task.action_scale * expected[None]).float())
        seen = groups["actor"]
    assert robot.velocity()[0] > 0.4  # it walks: the comparison is not one of two heaps


def test_a_robot_walks_on_after_the_time_limit():
    paths = []
    for limit in (1000, 10):
        policy, path = load("go1", "cpu"), []
        policy.config = policy.config.with_task(episode_length=limit)
        player = Player(policy, [1.0] * len(policy.objectives))
        for _ in range(20):
            player.step()
            path.append([*player.data.qpos, *player.returns.tolist()])
        paths.append(path)
    np.testing.assert_array_equal(*paths)


def test_a_robot_without_the_base_s_velocity_remembers_as_in_training(tmp_path, monkeypatch):
    registry, chosen = import_module("mjlab.tasks.registry"), import_module("mjlab.managers")
    usual = registry.load_env_cfg

    def some_joints(task: str, play: bool = False) -> Any:
        cfg, order = usual(task, play), (".*_calf_joint", ".*_hip_joint", ".*_thigh_joint")
        for name, joints in {"joint_pos": order, "joint_vel": ("F[LR]_.*",)}.items():
            asset = chosen.SceneEntityCfg("robot", joint_names=joints, preserve_order=True)
            cfg.observations["actor"].terms[name].params["asset_cfg"] = asset
        return cfg

    monkeypatch.setattr(registry, "load_env_cfg", some_joints)
    lengths = {"joint_*": 3, "command": 2}
    given = {"task.sensors": "real", "task.history": lengths, "network.symmetric": True}
    config = tiny(GO1, backend=None, **FEW, **given)
    run = train(config, output=tmp_path / "run").folder
    export.command([str(run), "--output", str(tmp_path / "exported" / "family.onnx")])
    deployment, command = open_export(tmp_path / "exported"), np.array([0.6, 0.2, -0.3])
    env, robot, policy = calm(config.env, 1), Robot(deployment), Policy(deployment)
    env.command_manager.get_term("twist").command.copy_(torch.tensor(command)[None])
    manager = env.observation_manager
    names, frames = manager.active_terms["actor"], []
    sizes = [torch.Size(dim).numel() for dim in manager.group_obs_term_dim["actor"]]
    seen = manager.compute_group("actor")
    for _ in range(5):
        frames.append(dict(zip(names, seen[0].split(sizes), strict=True)))
        past = [frames[0]] * 2 + frames
        parts = []
        for name in (name for name in names if name != "base_lin_vel"):
            number = 3 if name.startswith("joint_") else 2 if name == "command" else 1
            parts += [row[name] for row in past[-number:]]
        observation = robot.observe(command)
        np.testing.assert_allclose(observation, torch.cat(parts).numpy(), rtol=0, atol=1e-3)
        action = policy.act(observation)
        robot.step(action)
        groups, *_ = env.step(torch.tensor(config.task.action_scale * action[None]).float())
        seen = groups["actor"]


def test_gains_limits_and_order_are_those_of_the_robot(exported):
    settings = yaml.safe_load((exported / "go1" / "deploy.yaml").read_text())
    own, action = settings["morlax_torch"], settings["actions"]["JointPositionAction"]
    assert own["joints"] == [f"robot/{name}" for name in action["joint_names"]]
    assert settings["stiffness"][:3] == pytest.approx([15.895, 15.895, 35.764], abs=1e-3)
    assert settings["damping"][:3] == pytest.approx([1.012, 1.012, 2.277], abs=1e-3)
    assert own["torque_limits"][:3] == [23.7, 23.7, 35.55]
    assert action["offset"] == settings["default_joint_pos"]
    assert list(settings["observations"])[-2:] == ["last_action", "velocity_commands"]
    assert (own["slew"], settings["step_dt"]) == (0.5, 0.02)


def test_an_export_that_play_cannot_run_is_not_said_to_be_for_it(tmp_path, capsys):
    export.command(["go1", "--format", "torchscript", "--output", str(tmp_path / "family.ts")])
    printed = "".join(capsys.readouterr().out.split())
    assert printed.endswith("deploy.yaml")


def test_two_terms_of_one_function_are_two_observations(monkeypatch):
    def doubled(name: str, *options: Any) -> Any:
        cfg = changed(name, *options)
        terms = cfg.observations["actor"].terms
        terms["legs"] = replace(terms["joint_pos"], scale=0.5)
        terms["lure"] = replace(terms["command"], params={"command_name": "prey"})
        ranges = replace(cfg.commands["twist"].ranges, lin_vel_x=(0.0, 9.0))
        cfg.commands["prey"] = replace(cfg.commands["twist"], ranges=ranges)
        return cfg

    changed = worlds.changed
    monkeypatch.setattr(worlds, "changed", doubled)
    robot = envs.make_robot(GO1)
    settings = robot.deployment().settings
    observations, terms = settings["observations"], settings["morlax_torch"]["observation_names"]
    names = "joint_pos_rel", "joint_pos_rel_legs"
    assert [observations[name]["scale"][0] for name in names] == [1, 0.5]
    assert len(observations) == len(terms) == len(robot.layout())
    assert observations["velocity_commands"]["params"] == {"command_name": "base_velocity"}
    assert observations["lure"]["params"] == {"command_name": "prey"}
    assert settings["commands"]["base_velocity"]["ranges"]["lin_vel_x"] == [-1.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "episodes", "falls"),
    [
        ("go1", 2, 0),
        ("g1", 2, 0),
        ("g1-tour", 2, 0),
        pytest.param("go1", 20, 0, marks=pytest.mark.long),
        pytest.param("g1", 10, 0, marks=pytest.mark.long),
        pytest.param("g1-tour", 10, 0, marks=pytest.mark.long),
    ],
)
def test_disturbed_episodes_while_the_trade_off_changes(exported, name, episodes, falls):
    deployment = open_export(exported / name)._replace(disturbances=Disturbances())
    total = summary(run(deployment, episodes, seconds=30.0))
    assert total.falls <= falls and total.seconds > 27 * episodes
    assert total.error < 0.3


def test_the_robot_of_the_tour_stands_its_first_punches(exported):
    deployment = open_export(exported / "g1-tour", "0,1,0,0")
    runs = [tour(deployment, Policy(deployment), run_id, seconds=10.0) for run_id in range(6)]
    assert all(run.completed for run in runs)
    assert np.mean([run.position for run in runs]) < 15  # cm
