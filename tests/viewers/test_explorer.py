"""The explorer without a browser: real-time simulation, runs, questions, and what is sent."""

import hashlib
import json
import os
import time
from collections.abc import Callable
from queue import Queue
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from browsing import PATIENCE
from filelock import FileLock
from growing import grow, train_on

from morlax_torch import MorlaxError, evaluate, load
from morlax_torch.configuration.schedules import Schedule
from morlax_torch.evaluation.evaluator import stride_of
from morlax_torch.runs import choosing
from morlax_torch.viewers.describing import described_task, front_map, moment_map
from morlax_torch.viewers.explorer import exhibits, library
from morlax_torch.viewers.explorer.exhibits import RunExhibit, Thresholds
from morlax_torch.viewers.explorer.session import Session, contact_arrows, frame_bytes, policies_of
from morlax_torch.viewers.player import PUSH, Player


@pytest.fixture
def session(make_policy) -> Session:
    return Session(make_policy("hopper"), None)


def play(session: Session, seconds: float, pace: float = 1.0) -> int:
    """Advance with a clock that ticks every 10 ms; returns the number of control steps."""
    ticks = [session.advance(tick / 100, pace) for tick in range(round(seconds * 100) + 1)]
    return sum(ticks)


def test_a_robot_moves_in_real_time(session):
    assert play(session, 1.0) == round(1 / session.env.dt)
    session.reset()
    assert session.steps == 0
    assert not session.returns.any()


def test_slow_motion_and_pause(session):
    assert play(session, 2.0, pace=0.25) == pytest.approx(0.5 / session.env.dt, abs=1)
    assert session.advance(3600.0) * session.env.dt <= 0.1 + 1e-9  # is not caught up with
    assert play(session, 1.0, pace=0.0) == 0


def test_a_new_tradeoff_acts_on_the_next_step(session):
    session.step()
    seen = session.observation
    session.tradeoff = (0.9, 0.1)
    session.step()
    action = session.policy(seen, (0.9, 0.1))[0]
    env = session.env
    env.apply(action[None])
    assert session.tradeoff == (0.9, 0.1)
    np.testing.assert_allclose(session.data.ctrl, env.physics.ctrl[0], rtol=1e-5)


def test_a_finished_episode_is_reported_and_a_new_one_starts(session):
    while session.last_episode is None:
        session.step()
    assert session.steps == 1
    assert len(session.last_episode["returns"]) == 2
    fell = session.last_episode["seconds"] < 200 * session.env.dt - 1e-9
    assert session.last_episode["fell"] == fell


def test_a_command_survives_resets_and_stays_within_its_limits(session, make_policy):
    assert not described_task(session.env)["velocities"]
    bruce = Session(make_policy("bruce"), None)
    bruce.step()
    assert bruce.observation[0, 144:146].tolist() == pytest.approx([0.12, 0.0])
    bruce.tell(1, 0.05)
    assert described_task(bruce.env)["velocities"]
    for _ in range(2):
        bruce.step()
        assert bruce.observation[0, 144:146].tolist() == pytest.approx([0.12, 0.05])
        bruce.reset()


@pytest.mark.usefixtures("crowd")
@pytest.mark.parametrize(
    ("task", "body", "free"),
    [("hopper", "torso", 1), ("ant", "torso", 2), ("crowd", "robot", 2), ("bowling", "ball", 2)],
)
def test_the_page_pushes_and_follows_the_robot_or_the_named_body(task, body, free, make_policy):
    session = Session(make_policy(task), None)
    model, speed = session.model, session.env.physics.qvel[0]
    session.push()
    start = model.body_dofadr[model.body(body).id]
    assert float(speed[start : start + free].norm()) == pytest.approx(PUSH)
    assert float(speed.norm()) == pytest.approx(PUSH)
    about = session.about()
    assert about["followed"] == model.body(body).id
    assert about["pushed"] == list(range(start, start + free))


def test_power_is_force_times_velocity(session):
    play(session, 0.3)
    model, data = session.model, session.data
    joints = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    torque = model.actuator_gear[:, 0] * data.ctrl
    assert session.told()["power"] == pytest.approx(np.abs(torque * data.qvel[joints]).sum())


def test_runs_are_listed_newest_first(workplace, make_run):
    for name, age in (("runs/hopper/old", 20), ("runs/new", 10)):
        file = make_run(workplace / name, "hopper", "best") / "checkpoints/best.pt"
        os.utime(file, (1e9 - age, 1e9 - age))
    assert list(library.labels())[-2:] == ["runs/new", "runs/hopper/old"]


def test_any_checkpoint_of_a_run_can_be_chosen(workplace, make_run):
    make_run(workplace / "runs/a", "hopper", "best", "latest")
    choice = library.choose("runs/a")
    assert (choice.checkpoint, list(choice.files)) == ("best", ["best", "latest"])
    assert library.choose("runs/a/checkpoints/latest.pt")[:2] == ("runs/a", "latest")
    with pytest.raises(MorlaxError, match="did you mean 'latest'"):
        library.choose("runs/a", "lates")


def test_a_front_with_other_objectives_is_not_shown(tmp_path, make_run, make_front):
    folder = make_run(tmp_path / "run", "hopper", "best")
    make_front(("run", "energy")).save(folder / "front.npz")
    assert policies_of(library.choose(str(folder)))[1] is None


def press(exhibit: RunExhibit, name: str) -> None:
    exhibit.react({"act": "press", "name": name})


def test_a_second_robot_keeps_the_tradeoff_while_the_new_one_is_steered():
    exhibit = RunExhibit(library.choose("hopper"), pytest.fail)
    exhibit.react({"act": "steer", "weights": [9.0, 1.0]})
    play(exhibit.robots[0], 0.2)
    press(exhibit, "add")
    assert exhibit.robots[0].steps == 0  # both start anew, to be comparable
    exhibit.react({"act": "steer", "weights": [2.0, 8.0]})
    assert [robot.tradeoff for robot in exhibit.robots] == [(0.9, 0.1), (0.2, 0.8)]
    press(exhibit, "add")
    press(exhibit, "add")
    with pytest.raises(MorlaxError, match="at most 4 robots"):
        press(exhibit, "add")
    exhibit.react({"act": "select", "robot": 0})
    for _ in range(5):
        press(exhibit, "remove")
    assert [robot.tradeoff for robot in exhibit.robots] == [(0.2, 0.8)]
    assert exhibit.state()["selected"] == 0


def test_a_trade_off_over_time_moves_the_sliders_until_the_user_does():
    schedule = Schedule(np.array([0.0, 0.4]), np.array([[1.0, 0.0], [0.2, 0.8]]))
    exhibit = RunExhibit(library.choose("hopper"), pytest.fail, schedule)
    (robot,), player = exhibit.robots, Player(load("hopper"), schedule)
    for _ in range(30):
        robot.step()
        player.step()
        assert robot.told()["tradeoff"] == player.tradeoff
    assert (robot.data.qpos == player.data.qpos).all()
    assert 0.2 < robot.tradeoff[0] < 0.8 and robot.told()["follows"] is True
    exhibit.react({"act": "steer", "weights": [3.0, 1.0]})
    play(robot, 0.2)
    assert robot.tradeoff == (0.75, 0.25) and robot.told()["follows"] is False
    while robot.steps % stride_of(robot.env.episode_length) != 1:
        robot.step()
    press(exhibit, "follow")
    robot.step()
    assert robot.tradeoff == (0.75, 0.25)  # until the next change, not that of the beginning
    press(exhibit, "reset")
    robot.step()
    assert robot.tradeoff == (1, 0)
    robot.renew(robot.policy, robot.front)  # training has written another checkpoint
    play(robot, 0.5)
    assert robot.tradeoff == pytest.approx((0.2, 0.8))
    press(exhibit, "add")
    assert [each.told()["follows"] for each in exhibit.robots] == [True, False]
    assert exhibit.robots[1].tradeoff == robot.tradeoff


@pytest.mark.slow
def test_thresholds_are_simulated_while_the_robots_go_on(monkeypatch, make_policy):
    monkeypatch.setattr(choosing, "MOST_BATCHES", 4)
    policy = make_policy("cheetah", task={"episode_length": 100})
    front, requests, found = evaluate(policy, 16), Queue(), []
    thresholds = Thresholds(Session(policy, front), front, requests.put, found.append)
    lowest, middle = np.quantile(front.returns[:, 0], [0, 0.5])

    def wait() -> None:
        while thresholds.searching:
            requests.get(timeout=PATIENCE)()

    began = time.perf_counter()
    thresholds.require(0, lowest)
    thresholds.require(0, middle)  # while the first is searched for
    assert time.perf_counter() - began < 1
    assert thresholds.state()["searching"]
    wait()
    expected = choosing.Chooser(policy, front).choose({"run": middle}, "energy")
    assert found == [expected.tradeoff]
    assert thresholds.state()["found"]["returns"] == expected.returns
    thresholds.require(1, 1e9)  # is cut to the front's best
    assert thresholds.levels[1] == front.returns[:, 1].max()
    thresholds.require(0, 1e9)
    wait()
    assert thresholds.reason.startswith("no simulated policy keeps every requirement")
    thresholds.require(1, None)
    thresholds.stop()
    wait()
    assert len(found) == 1 and thresholds.state()["levels"] == {}


def follow(exhibit: RunExhibit, requests: Queue, until: Callable[[dict], bool]) -> dict:
    """Look at a run's files as often as needed, and return the state that is waited for."""
    limit = time.monotonic() + PATIENCE
    while not until(state := exhibit.state()):
        assert time.monotonic() < limit
        if not requests.empty():
            requests.get()()
        time.sleep(0.02)
    return state


def test_the_policies_of_a_newer_checkpoint_act_while_the_robot_goes_on(
    tmp_path, monkeypatch, make_run
):
    monkeypatch.setattr(exhibits, "LOOK", 0.0)
    run, requests = make_run(tmp_path / "run", "hopper", "best"), Queue()
    grow(run)
    exhibit = RunExhibit(library.choose(str(run)), requests.put)
    state = follow(exhibit, requests, lambda state: bool(state["training"]))
    assert [moment["numbers"] for moment in state["training"]][1:] == [
        (1000.0, 10.0, 6000.0),
        (2000.0, 20.0, 9000.0),
    ]
    assert state["training"][-1]["fingerprint"] == state["front"]["fingerprint"]
    (robot,) = exhibit.robots
    play(robot, 0.1)
    policy, steps = load(run), robot.steps
    policy.agent.actor.bias.data += 0.1
    train_on(run, policy)
    before = state["front"]["returns"][0][0]
    follow(exhibit, requests, lambda state: state["front"]["returns"][0][0] == before + 1)
    assert exhibit.robots[0] is robot and robot.steps == steps > 0
    seen = robot.observation
    robot.step()
    expected = policy(seen, robot.tradeoff)[0]
    torch.testing.assert_close(robot._network(seen)[0], expected)

    # policies stay while a user judges them
    press(exhibit, "find")
    train_on(run, load("hopper"))
    for _ in range(20):
        state = exhibit.state()
        assert requests.empty() and state["front"]["returns"][0][0] == before + 1
    press(exhibit, "leave")
    follow(exhibit, requests, lambda state: state["front"]["returns"][0][0] == before + 2)


def test_a_run_that_is_being_trained_shows_its_latest_checkpoint(workplace, make_run):
    make_run(workplace / "runs/a", "hopper", "best", "latest")
    with FileLock(workplace / "runs/a/train.lock"):
        assert library.choose("runs/a").checkpoint == "latest"
        assert library.choose("runs/a", "best").checkpoint == "best"
    assert library.choose("runs/a").checkpoint == "best"


def test_a_run_with_damaged_bookmarks_is_not_opened_by_halves(workplace, make_run):
    exhibit = RunExhibit(library.choose("hopper"), Queue().put)
    damaged = make_run(workplace / "runs/b", "cheetah3", "best")
    (damaged / "bookmarks.yaml").write_text("calm: [0.2, ")
    press(exhibit, "find")
    before = exhibit.state()
    with pytest.raises(MorlaxError, match=r"bookmarks\.yaml is damaged"):
        exhibit.react({"act": "open", "run": "runs/b", "checkpoint": None})
    assert exhibit.state() == before


@pytest.mark.slow
def test_files_are_written_while_the_robots_go_on(tmp_path, monkeypatch, make_run):
    onnx = pytest.importorskip("onnx", reason="needs the extra onnx")
    monkeypatch.setattr(choosing, "MOST_BATCHES", 1)
    run = make_run(tmp_path / "run", "hopper", "best", "latest")
    requests = Queue()

    def saved(exhibit: RunExhibit) -> str:
        while exhibit.state()["saving"]["busy"]:
            requests.get(timeout=PATIENCE)()
        return exhibit.state()["saving"]["text"]

    exhibit = RunExhibit(library.choose(str(run), "latest"), requests.put)
    for weights in ([1.0, 3.0], [1.0, 0.0]):  # the second while the first is written
        exhibit.react({"act": "steer", "weights": weights})
        press(exhibit, "export")
    assert saved(exhibit).startswith(f"written: {run / 'policy.onnx'}")
    about = {p.key: p.value for p in onnx.load(run / "policy.onnx").metadata_props}
    assert json.loads(about["tradeoff"]) == [0.25, 0.75]
    latest = hashlib.sha256((run / "checkpoints/latest.pt").read_bytes()).hexdigest()
    assert json.loads(about["run"])["sha256"] == latest

    exhibit = RunExhibit(library.choose(str(run)), requests.put)
    exhibit.react({"act": "require", "index": 0, "level": -1e9})
    while exhibit.state()["choosing"]["searching"]:
        requests.get(timeout=PATIENCE)()
    press(exhibit, "card")
    assert saved(exhibit) == f"written: {run / 'decision.html'}"
    assert "As much jump as possible" in (run / "decision.html").read_text()


class Task:
    """What a map takes from a robot whose evaluations last 10 s, in a motion of 30 s."""

    dt, episode_length, lower_is_better = 0.05, 600, ("power (W)",)
    options = SimpleNamespace(episode_length=200)


def test_the_map_has_returns_and_physical_quantities(make_front, tmp_path):
    front = make_front(("run", "energy"))
    power = np.linspace(1.0, 2.0, len(front.returns))[:, None]
    sent = front_map(front._replace(quantities=power, quantity_names=("power (W)",)), Task())
    (measured,) = sent["measured"]
    assert measured.pop("values") == pytest.approx(power[:, 0].tolist(), abs=1e-4)
    assert measured == {"index": 2, "name": "power (W)", "lower": True}
    np.testing.assert_allclose(sent["returns"], front.returns, atol=0.01)
    assert sent["seconds"] == pytest.approx(10)
    assert sorted(sent["pair"]) == [0, 1] and not any(sent["fails"])
    # two quantities come first
    both = np.hstack([power, 3 * power])
    sent = front_map(front._replace(quantities=both, quantity_names=("power (W)", "v")), Task())
    assert sorted(sent["pair"]) == [2, 3]
    both[0, 1] = np.nan  # of a policy that fell at once
    sent = front_map(front._replace(quantities=both, quantity_names=("power (W)", "v")), Task())
    assert [one["name"] for one in sent["measured"]] == ["power (W)"]
    front._replace(quantities=both, quantity_names=("power (W)", "v")).save(tmp_path / "0.npz")
    moment = moment_map(tmp_path / "0.npz", 1.0)
    assert len(moment["values"]) > 1 and json.dumps(moment, allow_nan=False)
    sent = front_map(front._replace(falls=np.array([0.0, 0.25, 0.0, 1.0])), Task())
    assert sent["fails"] == [False, False, False, True] and sent["falls"] == [0, 0.25, 0, 1]


@pytest.mark.parametrize(("length", "counted"), [(200, 200), (1000, 500)])
def test_the_map_of_discounted_returns_counts_seconds_as_they_do(length, counted, make_front):
    options = SimpleNamespace(episode_length=length)
    task = SimpleNamespace(dt=0.05, options=options, lower_is_better=())
    sent = front_map(make_front(("run", "energy"))._replace(protocol="discounted"), task)
    assert sent["seconds"] == pytest.approx(0.05 * sum(0.99**t for t in range(counted)))


def test_twins_start_alike_and_stay_in_step():
    exhibit = RunExhibit(library.choose("ant"), pytest.fail, (1.0, 3.0))
    assert exhibit.robots[0].tradeoff == (0.25, 0.75)
    press(exhibit, "push")
    play(exhibit.robots[0], 0.2)
    for names in (["add"], ["reset", "push"]):
        for name in names:
            press(exhibit, name)
        for now in np.arange(0.0, 0.3, 0.017):
            for robot in exhibit.robots:
                robot.advance(now)
        first, second = exhibit.robots
        assert first.steps == second.steps > 0
        np.testing.assert_array_equal(first.data.qpos, second.data.qpos)


def test_a_state_that_is_not_finite_is_not_sent(session):
    assert frame_bytes([session]) is not None
    session.data.xpos[1] = np.nan
    assert frame_bytes([session]) is None


FALL = """
<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .1" mass="2"/></body>
</worldbody></mujoco>
"""


def test_arrows_of_contacts_carry_the_weight():
    model = mujoco.MjModel.from_xml_string(FALL)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    arrows = contact_arrows(model, data)
    expected = [0, 0, 0.5 * model.stat.extent]  # half its size for its weight
    assert (arrows[:, 1] - arrows[:, 0]).sum(0) == pytest.approx(expected, abs=0.01)
    data.qpos[2] -= 0.09  # an impact
    mujoco.mj_forward(model, data)
    arrows = contact_arrows(model, data)
    lengths = np.linalg.norm(arrows[:, 1] - arrows[:, 0], axis=1)
    assert lengths.max() == pytest.approx(model.stat.extent)
