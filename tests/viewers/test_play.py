"""An export is played in C MuJoCo: disturbances, trade-offs, steering, and mistakes."""

import io
import zipfile
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import yaml
from programs import played

from morlax_torch.commands import export, play
from morlax_torch.envs.bridges.mjlab.robot import gains
from morlax_torch.envs.worlds.mujoco_robot import Deployment
from morlax_torch.exports.deployment import deploy
from morlax_torch.viewers.playing.episodes import (
    ENTER,
    EVENT,
    LEFT,
    UP,
    Gamepad,
    Policy,
    Steering,
    run,
    summary,
)
from morlax_torch.viewers.playing.robot import Disturbances, Export, Robot, open_export

onnx = pytest.importorskip("onnx", reason="needs the extra onnx")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")

CART = """<mujoco><option timestep="0.005"/><worldbody><light pos="0 0 3"/>
<geom name="floor" type="plane" size="5 5 .1"/><body name="base" pos="0 0 .11"><freejoint/>
<geom type="box" size=".3 .2 .1" mass="5"/><site name="imu"/>
{}</body></worldbody><actuator>
<position name="a" joint="left" kp="9" kv="1" forcerange="-2 2"/>
<position name="b" joint="right" kp="9" kv="1" forcerange="-2 2"/></actuator>
<sensor><gyro name="gyro" site="imu"/></sensor></mujoco>"""
ARM = (
    '<body pos="0 {1} .1"><joint name="{0}" axis="0 1 0" range="-57 57"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 .2" size=".02" mass=".1" contype="0"/></body>'
)
XML = CART.format(ARM.format("left", 0.25) + ARM.format("right", -0.25))
TERMS = {"base_ang_vel": 3, "joint_pos_rel": 2, "last_action": 2, "velocity_commands": 3}


def onnx_file(size: int, actions: int, family: bool = False) -> bytes:
    """Return a policy whose action is zero, or that of a `family` its trade-off."""
    make, kind = onnx.helper, onnx.TensorProto.FLOAT
    shapes = {"observation": ["batch", size], "tradeoff": [2], "action": ["batch", actions]}
    values = {k: make.make_tensor_value_info(k, kind, shape) for k, shape in shapes.items()}
    zeros = make.make_tensor("zeros", kind, [size, actions], [0.0] * size * actions)
    product = "nothing" if family else "action"
    nodes = [make.make_node("MatMul", ["observation", "zeros"], [product])]
    inputs = [values["observation"]]
    if family:
        nodes.append(make.make_node("Add", ["nothing", "tradeoff"], ["action"]))
        inputs.append(values["tradeoff"])
    graph = make.make_graph(nodes, "toy", inputs, [values["action"]], [zeros])
    opset = [make.make_opsetid("", 17)]
    return make.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()


def settings() -> dict:
    model = mujoco.MjModel.from_xml_string(XML)
    pairs = (gains(model, joint) for joint in ("left", "right"))
    stiffness, damping = map(list, zip(*pairs, strict=True))
    terms = {
        name: {"params": {}, "clip": None, "scale": [1.0] * size, "history_length": 1}
        for name, size in TERMS.items()
    }
    terms["base_ang_vel"]["params"] = {"sensor_name": "gyro"}
    terms["joint_pos_rel"]["history_length"] = 2
    terms["last_action"] |= {"scale": [3.0, 3.0], "clip": [-0.2, 0.2]}
    ranges = {"lin_vel_x": [-0.5, 1.0], "lin_vel_y": [-1.0, 1.0], "ang_vel_z": [-1.0, 1.0]}
    action = {"clip": None, "joint_names": ["left", "right"], "scale": [0.5, 0.5]}
    return {
        "step_dt": 0.02,
        "stiffness": stiffness,
        "damping": damping,
        "default_joint_pos": [0.1, -0.1],
        "commands": {"base_velocity": {"ranges": ranges}},
        "actions": {"JointPositionAction": action | {"offset": [0.1, -0.1], "joint_ids": None}},
        "observations": terms,
        "morlax_torch": {
            "joints": ["left", "right"],
            "default_joint_vel": [0.0, 0.0],
            "observation_noise": [0.2, 0.01, 0.0, 0.0],
        },
    }


def write(folder: Path, content: dict, xml: str = XML) -> Path:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as files:
        files.writestr("robot.xml", xml)
    robot = SimpleNamespace(deployment=lambda: Deployment(content, archive.getvalue()))
    (folder / "family.onnx").write_bytes(onnx_file(12, 2, family=True))
    deploy(robot, folder / "family.onnx", "cart", ["fast", "calm"], slew=0.5)
    return folder


@pytest.fixture
def cart(tmp_path: Path) -> Export:
    return open_export(write(tmp_path, settings()))


def test_a_ball_before_the_robot_changes_nothing(tmp_path):
    ball = '<body><freejoint/><geom size=".1" contype="0" conaffinity="0"/></body>'
    behind = XML.replace('<body name="base"', f'{ball}<body name="base"')
    strengths, motions = Disturbances(push=1.0), []
    for number, xml in enumerate((XML, behind)):
        (folder := tmp_path / str(number)).mkdir()
        export = open_export(write(folder, settings(), xml))
        robot = Robot(export._replace(disturbances=strengths), seed=1)
        seen = [robot.observe(np.zeros(3)) for _ in range(80) if robot.step(np.ones(2))]
        motions.append([*np.ravel(seen), *robot.velocity(), robot.weight()])
    np.testing.assert_allclose(*motions, atol=1e-6)


def test_an_observation_has_the_order_scales_clips_and_history_of_its_settings(cart):
    robot, command = Robot(cart), np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(robot.observe(command), [0] * 9 + [0.3, -0.2, 0.1], atol=1e-9)
    robot.step(np.array([0.1, -0.4]))
    turn, before, now, action, _ = np.split(robot.observe(command), [3, 5, 7, 9])
    np.testing.assert_allclose(turn, robot.data.sensor("gyro").data)
    assert not before.any() and now.all() and now[0] > now[1]
    np.testing.assert_allclose(action, [0.3, -0.6])  # clipped, then scaled


def test_gains_that_a_user_edits_are_those_of_the_motors(cart):
    cart.settings.stiffness, cart.settings.damping = [20.0, 9.0], [3.0, 0.5]
    robot = Robot(cart)
    assert robot.model.actuator_gainprm[:, 0].tolist() == [20, 9]
    assert robot.model.actuator_biasprm[:, 1].tolist() == [-20, -9]
    assert robot.model.actuator_biasprm[:, 2].tolist() == [-3, -0.5]


def test_a_motor_of_torque_moves_its_joint_to_the_target_by_the_gains_of_a_user(cart):
    servo = 'position name="a" joint="left" kp="9" kv="1"'
    assert servo in XML
    text = XML.replace(servo, 'motor name="a" joint="left" ctrlrange="-2 2"')
    motors = mujoco.MjModel.from_xml_string(text)
    servos, torques = Robot(cart), Robot(cart._replace(model=motors))
    for robot in (servos, torques):
        for _ in range(50):
            robot.step(np.array([6.0, -0.5]))
    np.testing.assert_allclose(torques.data.qpos, servos.data.qpos, atol=1e-3)


def test_a_trade_off_changes_no_faster_than_its_limit(cart):
    policy = Policy(cart)
    policy.choose([1.0, 0.0], at_once=True)
    policy.choose([0.0, 1.0])
    found = np.array([policy.act(np.zeros(12)) for _ in range(120)])
    np.testing.assert_allclose(np.diff(found[:99], axis=0), [[-0.01, 0.01]] * 98, atol=1e-6)
    np.testing.assert_allclose(found[100:], [[0, 1]] * 20)


def test_a_given_trade_off_holds_until_the_user_slides_it(cart, monkeypatch):
    cart, seen, act = open_export(cart.policy, "3,1"), [], Policy.act
    monkeypatch.setattr(Policy, "act", lambda *step: seen.append(act(*step)) or seen[-1])
    run(cart._replace(disturbances=Disturbances((0, 0), 0, 0)), 1, 10.0)
    np.testing.assert_allclose(seen, [[0.75, 0.25]] * 500)
    policy = Policy(cart)
    Steering(cart, policy).press(ord("9"))
    for _ in range(200):
        policy.act(np.zeros(12))
    assert policy.tradeoff.tolist() == [1, 0]


@pytest.mark.parametrize(("delay", "steps"), [(0, 0), (10, 2), (25, 5)])
def test_actions_are_delayed_by_physics_steps(cart, delay, steps, monkeypatch):
    robot = Robot(cart._replace(disturbances=Disturbances((delay, delay), 0, 0)))
    targets, usual = [], mujoco.mj_step
    monkeypatch.setattr(mujoco, "mj_step", lambda m, d: (targets.append(d.ctrl[0]), usual(m, d))[1])
    for action in (0.2, 0.4):
        robot.step(np.full(2, action))
    expected = [0.1] * steps + [0.2] * 4 + [0.3] * 4
    np.testing.assert_allclose(targets, expected[:8])


def test_friction_noise_and_pushes_have_the_strength_that_is_asked_for(cart):
    strengths = Disturbances((0, 0), 2.0, 0.5, (0.4, 0.5))
    robot = Robot(cart._replace(disturbances=strengths))
    sliding = robot.model.geom_friction[:2, 0]
    assert (sliding >= 0.4).all() and (sliding <= 0.5).all()
    seen = np.array([robot.observe(np.zeros(3)) for _ in range(300)])
    assert 0.35 < np.abs(seen[:, :3]).max() <= 0.4  # twice that of the training
    speeds = []
    for _ in range(160):  # 3.2 s: at least one push
        before = robot.data.qvel[:2].copy()
        robot.step(np.zeros(2))
        speeds.append(np.abs(robot.data.qvel[:2] - before).max())
    assert 0.01 < max(speeds) < 0.55
    assert not Robot(cart).observe(np.zeros(3)).any()  # without disturbances


def test_a_tilted_or_broken_robot_has_fallen(cart):
    robot = Robot(cart)
    assert not robot.step(np.zeros(2)).fallen
    robot.data.qpos[3:7] = np.cos(0.7), np.sin(0.7), 0, 0  # 80 degrees
    assert robot.step(np.zeros(2)).fallen
    robot.reset()
    robot.data.qvel[6] = np.nan
    assert robot.step(np.zeros(2)).fallen


def test_episodes_are_the_same_for_the_same_seed(cart):
    disturbed = cart._replace(disturbances=Disturbances())
    one, other = (run(disturbed, 2, 1.0, seed=3) for _ in range(2))
    assert one == other and one[0] != one[1]
    assert one[0].seconds == pytest.approx(1) and one[0].power > 0
    at_once = one[0]._replace(falls=1.0, seconds=0.02, error=np.nan, power=np.nan, speed=np.nan)
    assert summary([one[0], at_once]).power == pytest.approx(one[0].power)


def test_keys_and_sticks_steer_within_the_ranges(cart, tmp_path):
    policy = Policy(cart)
    steering = Steering(cart, policy)
    for key in (*[UP] * 20, LEFT, ord("9")):
        steering.press(key)
    np.testing.assert_allclose(steering.command, [1.0, 0.0, 0.1])
    assert policy.target.tolist() == [1, 0]
    assert steering.words()[0].splitlines()[-1] == "calm"
    steering.press(ENTER)
    assert not steering.command.any()
    events = EVENT.pack(0, 32767, 2, 1) + EVENT.pack(1, 1, 1, 0)  # back, and a button
    (tmp_path / "js0").write_bytes(events)
    for event in Gamepad(tmp_path / "js0").events():
        steering.feel(*event)
    np.testing.assert_allclose(steering.command, [-0.5, 0, 0], atol=1e-9)
    assert policy.target.tolist() == [0, 1]


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_without_a_display_a_film_is_written(cart, workplace, monkeypatch, capsys):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    monkeypatch.setattr("morlax_torch.viewers.window.has_display", lambda: False)
    play.command([str(cart.policy.parent), "--seconds", "0.2"])
    assert "written: film.mp4" in capsys.readouterr().out
    assert (workplace / "film.mp4").stat().st_size > 1000


def test_a_display_that_does_not_work_is_named(cart, monkeypatch, refused):
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("glfw.init", lambda: False)
    message = refused(play, cart.policy.parent, "--seconds", "1")
    assert "there is no screen here: write a film with --output film.mp4." in message


def test_mistakes_are_one_sentence(cart, refused, make_run, tmp_path):
    folder = cart.policy.parent
    assert "there is no export nowhere" in refused(play, "nowhere")
    assert "seed: Input should be greater than or equal to 0" in refused(play, folder, "--seed=-1")
    assert "--delay must not be negative" in refused(play, folder, "--delay", "20", "0")
    assert "over the time of a motion" in refused(play, folder, "--tradeoff", "x.yaml")
    assert "needs 2 numbers" in refused(play, folder, "--tradeoff", "1", "--episodes", "1")
    filmed = refused(play, folder, "--episodes", "1", "--output", "film.mp4")
    assert "--output has no effect with --episodes" in filmed
    steered = refused(play, folder, "--output", "film.mp4", "--gamepad", "/dev/input/js0")
    assert "--gamepad steers a robot in a window, not in a film" in steered
    hopper = make_run(tmp_path / "hopper", "hopper", "best")
    assert "hopper does not have" in refused(export, hopper, "--slew", "1")
    changes = {
        "actions.JointPositionAction.clip: Field required": lambda content: content.pop("actions"),
        "offset has 1 entries instead of 2": lambda content: content["actions"][
            "JointPositionAction"
        ]["offset"].pop(),
        "ranges needs lin_vel_x": lambda content: content["commands"].clear(),
        "step_dt is 0.001: use a multiple of 0.005": lambda content: content.update(step_dt=0.001),
        "Got: 14 Expected: 12": lambda content: content["observations"]["joint_pos_rel"].update(
            history_length=3
        ),
        "no joint knee": lambda content: content["morlax_torch"]["joints"].__setitem__(0, "knee"),
    }
    text = (folder / "deploy.yaml").read_text()
    for sentence, change in changes.items():
        content = yaml.safe_load(text)
        change(content)
        (folder / "deploy.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
        assert sentence in refused(play, folder, "--episodes", "1", "--seconds", "0.1")
    (folder / "deploy.yaml").write_text(text)
    (folder / "other.onnx").write_bytes(onnx_file(12, 3))
    words = folder / "other.onnx", "--episodes", "1", "--seconds", "0.1"
    assert "cannot run" in refused(play, *words)
    (folder / "robot.zip").write_bytes(b"no zip")
    assert "cannot load the model" in refused(play, folder)


def test_play_imports_neither_torch_nor_the_simulator_of_the_training(cart):
    assert "cost of transport" in played(cart.policy.parent, "--seconds", "0.2")
