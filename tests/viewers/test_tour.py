"""A tour is scored in C MuJoCo by the rules of the public benchmark."""

import math
from itertools import islice

import mujoco
import numpy as np
import pytest
from test_play import onnx_file  # skips these tests, too, where there is no ONNX

from morlax_torch import envs
from morlax_torch.commands import play
from morlax_torch.exports.deployment import deploy
from morlax_torch.viewers.playing.episodes import Policy
from morlax_torch.viewers.playing.robot import Export, open_export
from morlax_torch.viewers.playing.tour import WALK, Walker, command, costs, plan, tour


def test_waypoints_and_punches_have_their_distributions():
    draws = (plan(np.random.default_rng(run_id)) for run_id in range(10_000))
    points, joints, forces = (np.array(values) for values in zip(*draws, strict=True))
    away = np.linalg.norm(points[..., :2] - (0.3, 0), axis=2)
    assert away.max() <= 1 and (away < 0.5).mean() == pytest.approx(0.25, abs=0.005)
    assert np.abs(points[..., 2]).max() <= math.pi and abs(points[..., 2].mean()) < 0.02
    np.testing.assert_allclose(np.bincount(joints.ravel()), 180_000 / 29, rtol=0.06)
    sizes = np.linalg.norm(forces, axis=2)
    ceiling = np.array([500 / 3 + 1000 / 3 * min(index / 12, 1) for index in range(18)])  # N
    assert ceiling[0] == pytest.approx(500 / 3) and (ceiling[12:] == 500).all()
    deciles = np.quantile(sizes / ceiling, np.linspace(0, 1, 11), axis=0)
    uniform = np.linspace(0.5, 1, 11)[:, None]
    np.testing.assert_allclose(deciles, np.broadcast_to(uniform, (11, 18)), atol=0.01)
    # a direction on the sphere has uniform coordinates
    np.testing.assert_allclose((forces / sizes[..., None] < 0.5).mean((0, 1)), 0.75, atol=0.005)


def test_a_command_follows_the_error_until_the_waypoint_is_reached():
    limits, reached = np.array([(-0.6, 1.0), (-0.5, 0.5), (-1.0, 1.0)]), np.zeros(2, bool)
    expected = {  # error in m, m, rad: command in m/s, m/s, rad/s
        (0.4, -0.2, 0.5): (0.6, -0.3, 0.75),
        (2.0, 2.0, -3.0): (1.0, 0.5, -1.0),
        (-2.0, 0.3, 0.06): (-0.6, 0.45, 0.09),
        (0.12, 0.0, 0.04): (0.18, 0.0, 0.0),  # heading reached
        (0.06, 0.06, 0.11): (0.0, 0.0, 0.0),  # position, too: both go on until they are left
        (0.15, 0.1, 0.13): (0.0, 0.0, 0.195),
        (0.15, 0.15, 0.06): (0.225, 0.225, 0.09),
    }
    for error, wish in expected.items():
        found = command(np.array(error), reached, limits)
        np.testing.assert_allclose(found, wish, atol=1e-12, err_msg=str(error))


def test_energy_and_vibration_of_an_oscillation():
    dt, frequency, speed, torque = 0.02, 2 * math.pi * 1.3, 3.0, -4.0
    times = np.arange(round(90 / dt)) * dt
    speeds = speed * np.sin(frequency * times)
    energy, vibration = costs(np.full((len(times), 2), torque), np.stack([speeds, -speeds], 1), dt)
    mean = 2 / math.pi  # of |sin|
    assert energy == pytest.approx(2 * 4.0 * speed * mean * 90 / 1e3, rel=0.01)
    second = 4 * math.sin(frequency * dt / 2) ** 2 / dt * speed  # of differences of the speed
    assert vibration == pytest.approx(2 * second * mean * len(times) / 1e6, rel=0.01)


@pytest.fixture(scope="module")
def export(tmp_path_factory) -> Export:
    """Export a policy that always wishes for the default pose."""
    pytest.importorskip("mjlab", reason="needs the extra mjlab")
    folder, task = tmp_path_factory.mktemp("tour"), "mjlab:Mjlab-Tour-Flat-Unitree-G1"
    robot = envs.make_robot(task)
    size = sum(part.size for part in robot.layout())
    (folder / "policy.onnx").write_bytes(onnx_file(size, 15))
    deploy(robot, folder / "policy.onnx", task, ["survival", "energy"], [0.5, 0.5])
    return open_export(folder)


def test_arms_walk_as_mirror_images_within_their_ranges_before_the_robot(export):
    robot, right = Walker(export), np.array([1, -1, -1, 1, -1, 1, -1])
    names = export.settings.joints
    assert len(export.settings.driven) == 15 and names[15].endswith("left_shoulder_pitch_joint")
    path = np.array(list(islice(robot.arms(np.random.default_rng(3)), 2000)))
    limits = np.array([robot.model.joint(name).range for name in names])
    assert (path >= limits[15:22, 0]).all() and (path <= limits[15:22, 1]).all()
    assert np.abs(path[24::25] - path[0]).max() > 0.5  # rad
    np.testing.assert_allclose(np.diff(path.reshape(80, 25, 7), 2, axis=1), 0, atol=1e-12)
    model, data = export.model, mujoco.MjData(export.model)
    addresses = [model.joint(name).qposadr[0] for name in names]
    places = []
    for left in (np.array(export.settings.default_joint_pos[15:22]), *path[24::25]):
        data.qpos[addresses[15:]] = [*left, *left * right]
        mujoco.mj_kinematics(model, data)
        torso = data.body("robot/torso_link")
        hands = [data.body(f"robot/{side}_wrist_yaw_link").xpos for side in ("left", "right")]
        places.append((np.array(hands) - torso.xpos) @ torso.xmat.reshape(3, 3))
    stance, *walked = places
    assert np.ptp(walked, axis=0)[0].max() > 0.1  # m
    assert (np.array(walked)[..., 0] > stance[:, 0].min() - 0.09).all()  # 0.09 m: of the hand
    assert (np.array(walked)[..., 2] < 0.33).all()  # the head begins at 0.28 m
    np.testing.assert_allclose(stance[0] * (1, -1, 1), stance[1], atol=1e-4)


def test_servos_and_punches_push_as_they_should(export, monkeypatch):
    robot, forces, usual = Walker(export), [], mujoco.mj_step
    assert robot.data.qpos[2] == 0.793
    assert robot.data.qpos[7:].tolist() == export.settings.default_joint_pos
    for _ in range(10):  # in the air, until joints move
        robot.walk(np.full(15, 0.2), robot.data.qpos[22:29], 0, np.zeros(3))
    action, settings = np.full(15, 0.3), export.settings
    targets = np.array(settings.default_joint_pos)
    targets[:15] += 0.3 * np.array(settings.scale)
    error = targets - robot.data.qpos[7:]
    expected = np.array(settings.stiffness) * error - settings.damping * robot.data.qvel[6:]
    limits = np.array([88, 88, 88, 139, 50, 50] * 2 + [88, 50, 50] + [*[25] * 5, 5, 5] * 2)
    torques, _ = robot.walk(action, targets[15:22], 0, np.zeros(3))
    np.testing.assert_allclose(torques, expected.clip(-limits, limits), atol=1e-9)

    def step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        forces.append(data.qfrc_applied[:3].copy())  # of the base: the whole force
        usual(model, data)

    monkeypatch.setattr(mujoco, "mj_step", step)
    monkeypatch.setattr("morlax_torch.viewers.playing.tour.LOWEST", -1.0)
    tour(export, Policy(export), 5, 10.0)
    steps = np.linalg.norm(forces, axis=1).reshape(500, 10)  # physics steps of control steps
    assert np.flatnonzero(steps[:, 0]).tolist() == [5, 6, 7, 8, 255, 256, 257, 258]
    _, _, wished = plan(np.random.default_rng(5))
    np.testing.assert_allclose(steps[5:9], np.linalg.norm(wished[0]), rtol=1e-6)
    np.testing.assert_allclose(steps[255:259], np.linalg.norm(wished[1]), rtol=1e-6)


def test_a_robot_that_wishes_for_its_default_pose_falls_early(export, capsys, refused):
    folder = export.policy.parent
    runs = [tour(export, Policy(export), run_id) for run_id in range(4)]
    assert all(0.8 < run.seconds < 5 and not run.completed for run in runs)
    assert all(run.energy > 0.01 and run.vibration > 0.001 for run in runs)
    assert runs[1] == tour(export, Policy(export), 1) and runs[1] != runs[2]
    play.command([str(folder), "--tour", "--tour-runs", "4"])
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    printed = {name.strip(): value.strip() for _, name, value, _ in rows}
    assert printed["survival (s)"] == f"{np.mean([run.seconds for run in runs]):.1f}"
    assert (printed["completed (%)"], printed["walk energy (kJ)"]) == ("0.0", "-")
    power = np.sum([run.energy for run in runs]) / np.sum([run.seconds for run in runs])
    assert printed["energy of all (kJ)"] == f"{power * WALK:.1f}"
    assert "fixed trade-off" in refused(play, folder, "--tour", "--tradeoff", "1,0")
    assert "--push has no effect in a tour" in refused(play, folder, "--tour", "--push", "2")
    assert "--seed has no effect in a tour" in refused(play, folder, "--tour", "--seed", "2")
    assert "no effect without a tour" in refused(
        play, folder, "--episodes", "1", "--tour-runs", "2"
    )
    assert "--seconds at most 90" in refused(play, folder, "--tour", "--seconds", "91")
    text = (folder / "deploy.yaml").read_text()
    (folder / "deploy.yaml").write_text(text.replace("left_elbow_joint", "left_knee_joint"))
    assert "train mjlab:Mjlab-Tour" in refused(play, folder, "--tour")
