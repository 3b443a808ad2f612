"""The export of a policy that follows a motion does so in C MuJoCo as in mjlab."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
import yaml
from calm import calm
from motions import squat, write_squat
from programs import played
from tiny import FEW, tiny

from morlax_torch import load as load_policy
from morlax_torch.commands import export, play
from morlax_torch.configuration.schedules import Schedule
from morlax_torch.train import train
from morlax_torch.viewers.explorer.session import Session, frame_bytes
from morlax_torch.viewers.filming.recording import Take
from morlax_torch.viewers.player import Player
from morlax_torch.viewers.playing.episodes import Policy, run
from morlax_torch.viewers.playing.following import robot_for
from morlax_torch.viewers.playing.robot import open_export

pytest.importorskip("mjlab", reason="needs the extra mjlab")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")

TASK, SECONDS, STAND = "mjlab:Mjlab-Tracking-Flat-Unitree-G1", 0.8, 2.0


@pytest.fixture(scope="module")
def motion(tmp_path_factory) -> Path:
    return write_squat(tmp_path_factory.mktemp("motion") / "squat.npz", SECONDS)


@pytest.fixture(scope="module")
def exported(motion, tmp_path_factory) -> dict[str, Path]:
    """Return the folders of exports of runs that have hardly learned, by task."""
    few = {**FEW, "task.motion_file": str(motion), "task.action_scale": 1.0}
    few["evaluation.tradeoffs"] = 8
    folder, folders = tmp_path_factory.mktemp("exported"), {}
    for task in (TASK, f"{TASK}-No-State-Estimation"):
        name = task.partition(":")[2]
        trained = train(tiny(task, backend=None, **few), output=folder / name / "run").folder
        folders[task] = folder / name / "out"
        export.command([str(trained), "--output", str(folders[task] / "family.onnx")])
    return folders


def undisturbed(task: str, motion: Path) -> Any:
    """Return mjlab's environment of a robot that starts with the motion, turned and shifted."""

    def turn(cfg: Any) -> None:
        cfg.terminations = {"time_out": cfg.terminations["time_out"]}
        command = cfg.commands["motion"]
        command.motion_file = str(motion)
        command.pose_range = {"x": (0.3, 0.3), "pitch": (0.1, 0.1), "yaw": (2.0, 2.0)}

    env = calm(task, 1, edit=turn)
    return env, env.reset()[0]


@pytest.mark.parametrize("task", [TASK, f"{TASK}-No-State-Estimation"])
def test_observations_and_errors_are_those_of_mjlab(exported, motion, task):
    robot, (env, groups) = robot_for(open_export(exported[task])), undisturbed(task, motion)
    command, state = env.command_manager.get_term("motion"), env.sim.data
    rng, errors = np.random.default_rng(0), []
    for _ in range(30):
        assert robot.frame == command.time_steps.item()
        robot.data.qpos[:], robot.data.qvel[:] = state.qpos[0].numpy(), state.qvel[0].numpy()
        mujoco.mj_forward(robot.model, robot.data)
        observation = robot.observe(np.zeros(3))
        np.testing.assert_allclose(observation, groups["actor"][0].numpy(), rtol=0, atol=1e-4)
        action, aims = rng.uniform(-1, 1, robot.action.shape), command.body_pos_relative_w
        error = robot.step(action).error
        groups, *_ = env.step(torch.tensor(action[None]).float())
        errors.append((error, 1000 * (aims - command.robot_body_pos_w).norm(dim=-1).mean()))
    np.testing.assert_allclose(*np.array(errors).T, rtol=1e-3)
    assert np.ptp(errors) > 50  # mm


def test_a_motion_is_played_from_stand_to_stand_without_mjlab(exported):
    folder = exported[f"{TASK}-No-State-Estimation"]
    file = folder / "deploy.yaml"
    settings = yaml.safe_load(file.read_text())
    # so that even a policy without skill stands
    settings["stiffness"], settings["damping"] = [800.0] * 29, [20.0] * 29
    file.write_text(yaml.safe_dump(settings, sort_keys=False))
    deployment = open_export(folder)
    robot, frames = robot_for(deployment), squat(SECONDS)
    np.testing.assert_allclose(robot.data.qpos, frames[0], atol=1e-6)
    assert not robot.data.qvel.any()
    robot.step(np.zeros(29))
    np.testing.assert_allclose(robot.ghost().qpos, frames[1], atol=1e-6)
    (episode,) = run(deployment, 1, 100.0)
    assert episode.falls == 0 and 20 < episode.error < 200
    assert episode.seconds == pytest.approx(SECONDS + STAND, abs=0.03)
    assert "error, mm" in played(folder, "--push", "0")


def test_a_trade_off_over_time_is_followed_at_the_phase(exported, refused, tmp_path, capsys):
    names, file = open_export(exported[TASK]).settings.objectives, tmp_path / "schedule.yaml"
    schedule = Schedule(np.array([0.0, 0.3, 0.6]), np.eye(len(names))[:3] + 0.1)
    schedule.save(file, names)
    deployment = open_export(exported[TASK], str(file))
    robot, policy = robot_for(deployment), Policy(deployment)
    for _ in range(2):
        for frame in range(20):
            policy.drive(robot, np.zeros(3))
            weights = schedule.at(0.02 * frame)
            np.testing.assert_allclose(policy.tradeoff, weights / weights.sum(), atol=1e-6)
        robot.reset()
    words = [str(exported[TASK]), "--episodes", "1", "--tradeoff", str(file)]
    play.command(words)
    assert "error, mm" in capsys.readouterr().out
    schedule.save(file, (*names[1:], "speed"))
    assert f"weights`, as many for each of {names[0]}" in refused(play, *words)


def test_a_ghost_on_the_page_is_at_the_phase_of_the_robot(exported):
    session = Session(load_policy(str(exported[TASK].parent / "run"), "cpu"), None)
    model, data = session.model, mujoco.MjData(session.model)
    assert session.about()["motion"] == pytest.approx(SECONDS + STAND, abs=0.03)
    for frame in squat(SECONDS)[:12]:  # more than an episode of the training
        data.qpos[:] = frame
        mujoco.mj_kinematics(model, data)
        numbers = np.frombuffer((frame_bytes([session]) or b"")[4:], np.float32)
        ghost = numbers[-7 * model.nbody :]
        np.testing.assert_allclose(ghost, [*data.xpos.flat, *data.xquat.flat], atol=1e-5)
        session.step()


def test_a_robot_stays_as_its_episode_ended(exported):
    take = Take(Player(load_policy(str(exported[TASK].parent / "run"), "cpu"), [1.0] * 7), 95, 65)
    player, env = take.player, take.player.env
    env.motion.reset_to_frame(torch.arange(1), 136)
    env.motion.time_steps += 1
    env.age.fill_(136)
    while not take.done:
        take.step()
    assert player.steps == 3 and not take.failed
    np.testing.assert_allclose(player.ghost.qpos, squat(SECONDS)[39], atol=1e-6)
    np.testing.assert_allclose(player.data.qpos[7:], squat(SECONDS)[39, 7:], atol=0.3)  # rad
    take.reset()
    np.testing.assert_allclose(player.ghost.qpos, squat(SECONDS)[0], atol=1e-6)
    env.physics.qpos[0, 2] -= 0.3  # m
    take.step()
    assert take.failed and player.data.qpos[2] < 0.6


def test_motions_of_a_folder_are_shown_in_turn_and_exported_one_by_one(tmp_path):
    for name, seconds in (("a", SECONDS), ("b", 1.0)):
        (tmp_path / "clips").mkdir(exist_ok=True)
        write_squat(tmp_path / f"clips/{name}.npz", seconds)
    few = {**FEW, "task.motion_file": str(tmp_path / "clips"), "evaluation.tradeoffs": 8}
    few["task.motion_stand"] = 0.0
    trained = train(tiny(TASK, backend=None, **few), output=tmp_path / "run").folder
    player = Player(load_policy(str(trained), "cpu"), [1.0] * 7)
    motion = player.env.motion
    motion.reset_to_frame(torch.arange(1), 37)
    motion.time_steps += 1
    poses = [squat(SECONDS)[38], squat(1.0)[0], squat(1.0)[0], squat(1.0)[1]]
    for frame, pose in zip((39, 40, 41, 42), poses, strict=True):
        player.step()
        assert motion.time_steps.item() == frame and not player.over
        np.testing.assert_allclose(player.ghost.qpos, pose, atol=1e-6)
        np.testing.assert_allclose(player.data.qpos[7:], pose[7:], atol=0.3)  # rad
    player.reset()
    np.testing.assert_allclose(player.ghost.qpos, squat(SECONDS)[0], atol=1e-6)
    export.command([str(trained), "--output", str(tmp_path / "out/family.onnx")])
    deployment, file = open_export(tmp_path / "out"), tmp_path / "out/deploy.yaml"
    assert deployment.duration == pytest.approx(SECONDS)
    file.write_text(file.read_text().replace("motion.npz", "motion2.npz"))
    assert open_export(tmp_path / "out").duration == pytest.approx(1.0)


def test_a_motion_that_is_missing_or_another_robot_s_is_one_sentence(exported, refused):
    assert "follows a motion, no waypoints" in refused(play, exported[TASK], "--tour")
    file = exported[TASK] / "motion.npz"
    content = dict(np.load(file))
    np.savez(file, **content | {"joint_pos": content["joint_pos"][:, 1:]})
    assert "joint_pos of " in refused(play, exported[TASK])
    file.write_bytes(b"no motion")
    assert "cannot load the motion" in refused(play, exported[TASK])
    file.unlink()
    assert "motion.npz" in refused(play, exported[TASK])
