"""The explorer without a browser: sliders, real-time simulation, runs and drawings."""

import json
import os
import re
import time
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import viser

from morlax_torch import MorlaxError, load
from morlax_torch.choose import choose
from morlax_torch.envs.worlds.randomization import horizontal
from morlax_torch.runs.fronts import load_front
from morlax_torch.viewers.explorer import camera, library, weights
from morlax_torch.viewers.explorer.charts import with_ends
from morlax_torch.viewers.explorer.drawing import Drawing
from morlax_torch.viewers.explorer.ground import lane_lines
from morlax_torch.viewers.explorer.history import INTERVAL, SECONDS, History
from morlax_torch.viewers.explorer.lineup import Lineup
from morlax_torch.viewers.explorer.overlays import contact_forces, heading, shortened, velocity
from morlax_torch.viewers.explorer.scene import geom_mesh
from morlax_torch.viewers.explorer.serving import Requests
from morlax_torch.viewers.explorer.session import PUSH, Session
from morlax_torch.viewers.explorer.stage import ABOVE
from morlax_torch.viewers.explorer.steering import explain
from morlax_torch.viewers.explorer.thresholds import Thresholds, scale


@pytest.fixture
def session(tmp_path, make_run) -> Session:
    return Session.open(library.choose(str(make_run(tmp_path / "run", "hopper", "best"))))


# sliders


def test_weights_sum_to_one_after_any_slider_moves():
    random = np.random.default_rng(0)
    for m in (2, 3, 5):
        current = weights.even(m)
        for _ in range(500):
            value = random.choice([0.0, 1.0, -3.0, 7.0, 1e-12, 1 - 1e-12, random.random()])
            index = int(random.integers(m))
            current = weights.move_slider(current, index, float(value))
            assert sum(current) == pytest.approx(1, abs=1e-9)
            assert min(current) >= 0
            assert current[index] == np.clip(value, 0, 1)


def test_the_other_weights_keep_their_proportions_or_split_the_rest_evenly():
    assert weights.move_slider((0.5, 0.3, 0.2), 0, 0.0) == pytest.approx((0, 0.6, 0.4))
    corner = weights.move_slider((0.5, 0.3, 0.2), 0, 1.0)
    assert corner == (1, 0, 0)
    assert weights.move_slider(corner, 0, 0.5) == pytest.approx((0.5, 0.25, 0.25))
    for value in (float("nan"), float("inf"), -float("inf")):
        assert weights.move_slider((0.7, 0.3), 1, value) == (0.7, 0.3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.7, 0.3", (0.7, 0.3)),
        ("(3 1)", (0.75, 0.25)),
        ("1;0", (1, 0)),
        (weights.show((0.125, 0.875)), (0.125, 0.875)),
        ("0.7,", None),
        ("0.7", None),
        ("1, 2, 3", None),
        ("0, 0", None),
        ("-1, 2", None),
        ("nan, 1", None),
        ("inf, 1", None),
        ("run, energy", None),
        ("", None),
    ],
)
def test_a_typed_tradeoff_is_parsed_or_ignored(text, expected):
    found = weights.read(text, 2)
    assert found == (None if expected is None else pytest.approx(expected))


# simulation in real time


def play(session: Session, seconds: float) -> int:
    """Advance with a clock that ticks every 10 ms; returns the number of control steps."""
    ticks = [session.advance(tick / 100) for tick in range(round(seconds * 100) + 1)]
    return sum(ticks)


def test_a_robot_moves_in_real_time(session):
    assert play(session, 1.0) == round(1 / session.dt)
    assert session.time == pytest.approx(1.0)
    session.reset()
    assert session.seconds == 0
    assert not session.player.returns.any()


def test_slow_motion_and_pause(session):
    session.pace = 0.25
    assert play(session, 2.0) == pytest.approx(0.5 / session.dt, abs=1)
    session.paused = True
    assert play(session, 1.0) == 0


def test_a_long_pause_of_the_clock_is_not_caught_up(session):
    session.advance(0.0)
    assert session.advance(3600.0) * session.dt <= 0.1 + 1e-9


def test_twins_act_alike(session):
    twin = session.twin()
    for robot in (session, twin):
        robot.reset()
        play(robot, 0.3)
    np.testing.assert_array_equal(session.data.qpos, twin.data.qpos)


def test_a_new_tradeoff_acts_on_the_next_step(session):
    session.step()
    seen = session.player.observation
    session.tradeoff = (0.9, 0.1)
    session.step()
    action = session.player.policy(seen, (0.9, 0.1))[0]
    env = session.player.env
    env.apply(action[None])
    assert session.player.tradeoff.tolist() == pytest.approx([0.9, 0.1])
    np.testing.assert_allclose(session.player.data.ctrl, env.physics.ctrl[0], rtol=1e-5)


def test_a_finished_episode_is_reported_and_a_new_one_starts(session):
    while session.last_episode is None:
        session.step()
    assert session.seconds == pytest.approx(session.dt)
    assert len(session.last_episode.returns) == 2
    assert session.last_episode.fell == (session.last_episode.seconds < 200 * session.dt - 1e-9)


def test_a_command_survives_resets_and_is_an_arrow(session, tmp_path, make_run):
    assert session.commanded() is None
    bruce = Session.open(library.choose(str(make_run(tmp_path / "bruce", "bruce", "best"))))
    bruce.step()
    assert bruce.player.observation[0, 144:146].tolist() == pytest.approx([0.12, 0.0])
    bruce.tell(1, 0.05)
    assert bruce.commanded() == pytest.approx([0.12, 0.05])
    for _ in range(2):
        bruce.step()
        assert bruce.player.observation[0, 144:146].tolist() == pytest.approx([0.12, 0.05])
        bruce.reset()


@pytest.mark.parametrize(("task", "free"), [("hopper", 1), ("ant", 2)])
def test_a_push_changes_only_free_horizontal_velocities(task, free, tmp_path, make_run):
    session = Session.open(library.choose(str(make_run(tmp_path / "run", task, "best"))))
    before = session.player.env.physics.qvel[0].clone()
    session.push()
    kick = session.player.env.physics.qvel[0] - before
    assert horizontal(session.player.model) == list(range(free))
    assert float(kick.norm()) == pytest.approx(PUSH)
    assert not kick[free:].any()


def test_power_is_force_times_velocity(session):
    play(session, 0.3)
    model, data = session.player.model, session.player.data
    joints = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    torque = model.actuator_gear[:, 0] * data.ctrl
    assert session.power() == pytest.approx(np.abs(torque * data.qvel[joints]).sum())


def test_history_keeps_interval_means_of_the_last_seconds_and_ends_of_episodes():
    history = History(1)
    history.end_episode()  # nothing has begun
    for step in range(1, 4001):
        history.add(step * 0.01, [float(step)])
        if step % 1500 == 0:
            history.end_episode()
            history.end_episode()
    time, value = history.columns()
    assert len(time) == round(SECONDS / INTERVAL)
    assert time[-1] == pytest.approx(40.0)
    assert value[-1] == pytest.approx(np.mean([3996, 3997, 3998, 3999, 4000]))
    assert history.ends() == pytest.approx([30.0])  # the end at 15 s is too long ago


# runs to explore


def test_runs_are_listed_newest_first(workplace, make_run):
    for name, age in (("runs/hopper/old", 20), ("runs/new", 10)):
        file = make_run(workplace / name, "hopper", "best") / "checkpoints/best.pt"
        os.utime(file, (1e9 - age, 1e9 - age))
    assert library.trained() == ["runs/new", "runs/hopper/old"]


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
    assert Session.open(library.choose(str(folder))).front is None


# drawings


def test_every_policy_of_the_front_can_be_picked(make_front):
    front = make_front(("run", "<b>", "height"))
    html = Drawing(front.objectives, front, (0, 2)).html()
    assert html.count("data-cell=") == 2  # the triangle, and a pair
    assert 'data-cell="0 2"' in html
    picked = {weights.read(text, 3) for text in re.findall(r'data-w="([^"]*)"', html)}
    expected = front.tradeoffs[front.non_dominated]
    np.testing.assert_allclose(sorted(picked), sorted(map(tuple, expected)), atol=2e-3)
    assert "<b>" not in html


def test_triangle_positions_map_to_tradeoffs():
    drawing = Drawing(("a", "b", "c"), None, (0, 1))
    rows = np.array(json.loads(re.findall(r'data-map="([^"]*)"', drawing.html())[0]))
    for tradeoff in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.3, 0.5)):
        mark = re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', drawing.marks(tradeoff, None))[0]
        np.testing.assert_allclose(rows @ [*map(float, mark), 1], tradeoff, atol=2e-3)


SHAPES = """
<mujoco><asset><mesh name="m" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3"/></asset><worldbody>
  <geom type="sphere" size=".2"/><geom type="capsule" size=".1 .3"/>
  <geom type="cylinder" size=".1 .3"/><geom type="box" size=".1 .2 .3"/>
  <geom type="ellipsoid" size=".1 .2 .3"/><geom type="mesh" mesh="m"/>
  <geom type="plane" size="1 1 1"/>
</worldbody></mujoco>
"""


def test_geom_meshes_match_mujoco_volumes_and_bounds():

    model = mujoco.MjModel.from_xml_string(SHAPES)
    pi = np.pi
    volumes = [
        4 / 3 * pi * 0.2**3,
        4 / 3 * pi * 0.1**3 + pi * 0.1**2 * 0.6,
        pi * 0.1**2 * 0.6,
        0.2 * 0.4 * 0.6,
        4 / 3 * pi * 0.1 * 0.2 * 0.3,
        0.3**3 / 6,
    ]
    for geom, volume in enumerate(volumes):
        mesh = geom_mesh(model, geom)
        assert mesh is not None
        assert mesh.volume == pytest.approx(volume, rel=0.03)
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        np.testing.assert_allclose(mesh.bounds, [middle - half, middle + half], atol=5e-3)
    assert geom_mesh(model, len(volumes)) is None


# several robots


def test_a_second_robot_keeps_the_tradeoff_while_the_new_one_is_steered(session):
    lineup = Lineup(session)
    assert lineup.names() == []
    session.tradeoff = (0.9, 0.1)
    play(session, 0.2)
    lineup.add()
    assert session.seconds == 0  # both start anew, so that their returns can be compared
    lineup.steered.tradeoff = (0.2, 0.8)
    assert [robot.tradeoff for robot in lineup.sessions] == [(0.9, 0.1), (0.2, 0.8)]
    assert lineup.names() == ["1: 0.90, 0.10", "▸ 2: 0.20, 0.80"]
    lineup.add()
    with pytest.raises(MorlaxError, match="at most 3 robots"):
        lineup.add()
    lineup.selected = 0
    for _ in range(5):
        lineup.remove()
    assert [robot.tradeoff for robot in lineup.sessions] == [(0.2, 0.8)]
    assert lineup.steered is lineup.sessions[0]


def test_names_of_robots_with_many_weights_are_short(tmp_path, make_run):
    run = make_run(tmp_path / "run", "cheetah3", "best")
    lineup = Lineup(Session.open(library.choose(str(run))))
    lineup.steered.tradeoff = (0.2, 0.7, 0.1)
    lineup.add()
    assert lineup.names() == ["1: 0.20, 0.70, 0.10", "▸ 2: 0.20, 0.70, 0.10"]
    lineup.add()
    assert lineup.names() == ["1: energy 0.70", "2: energy 0.70", "▸ 3: energy 0.70"]


# thresholds


@pytest.mark.parametrize(
    ("low", "high"), [(487.3, 2411.9), (-3.2, 0.01), (0.0, 1e-9), (5.0, 5.0), (-1e6, 3e7)]
)
def test_the_scale_of_a_threshold_covers_the_front_in_round_steps(low, high):
    least, most, step = scale(low, high)
    assert least <= low + 1e-6 and most >= high - 1e-6 and least < most
    assert (most - least) / step == pytest.approx(round((most - least) / step), abs=1e-6)
    assert most - least < (high - low) + 2.01 * step
    if high - low > 1e-3:
        assert 10 < (most - least) / step < 600


@pytest.mark.parametrize(("found", "label"), [(None, "go1 (needs mjlab)"), (object(), "go1")])
def test_the_list_of_policies_says_which_need_mjlab(monkeypatch, found, label):
    monkeypatch.setattr(library, "find_spec", lambda name: found)
    assert label in library.labels() and "ant" in library.labels()
    assert library.named(label) == "go1"


@pytest.mark.slow
def test_thresholds_are_simulated_while_the_robots_go_on():
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    requests, found = Requests(server), []
    policy = load("cheetah")
    thresholds = Thresholds(server.gui, policy, load_front("cheetah"), requests.put, found.append)

    def wait() -> str:
        """Execute what other threads queue, as the page does between two steps."""
        while (text := thresholds.result).find("data-searching") >= 0:
            requests.execute(0.01)
        return text

    try:
        began = time.perf_counter()
        thresholds.require(0, 1500.0)
        thresholds.require(0, 2000.0)  # while the first is searched for
        assert time.perf_counter() - began < 1
        assert "data-expected" in wait()
        assert found == [choose("cheetah", {"run": 2000.0}, "run", device="cpu").tradeoff]
        thresholds.require(1, 1e6)
        assert "no simulated policy keeps every requirement" in wait()
        thresholds.require(1, 2000.0)
        thresholds.stop()
        while thresholds.searching:
            requests.execute(0.01)
        assert len(found) == 1
    finally:
        server.stop()


def test_a_required_return_is_a_line_in_the_plots_that_show_it(make_front):
    front = make_front(("run", "energy", "height"))
    drawing = Drawing(front.objectives, front, (0, 2))
    html = drawing.marks((1, 0, 0), 0, levels={0: 60.0, 1: 70.0})
    assert re.findall(r'data-level="([^"]*)"', html) == ["60.00"]
    line = re.search(r'x1="([\d.]+)" x2="([\d.]+)"', html)
    point = np.array([float(x) for x in re.findall(r'cx="([\d.]+)"', drawing.html())])
    assert point.min() < float(line[1]) == float(line[2]) < point.max()


# what is drawn


def test_a_point_of_the_front_tells_its_tradeoff_and_returns(make_front):
    front = make_front(("run", "energy"))
    html = Drawing(front.objectives, front, (0, 1)).html()
    tip = "run: weight 1.00, return 110\nenergy: weight 0.00, return 10"
    assert re.sub(r"<title *>", "<title>", html).count(f"<title>{tip}</title>") == 1


def test_ends_of_episodes_are_vertical_lines_in_charts():

    columns = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 9.0, 0.5, 2.0]])
    time, marks, value = with_ends(columns, [2.0, 4.0])  # no sample follows the last end
    np.testing.assert_array_equal(time, [1, 2, 3, 3, 3, 3, 4])
    np.testing.assert_array_equal(marks, [0, 0, 0, 9, 0, 0, 0])
    np.testing.assert_array_equal(value, [5, 9, 9, 9, 0.5, 0.5, 2])


def test_an_objective_is_explained_by_its_reward_terms(session):
    env = session.player.env
    assert explain(env, "jump") == (
        "jump = 12 * jump. Every objective also gets 1 * alive - 0.0002 * ctrl_cost."
    )
    assert explain(env, "another") == "Weight of another."
    type(env).jump = lambda self: None
    try:
        type(env).jump.__doc__ = "Height of the torso in m.\n\nMore."
        assert "jump: Height of the torso in m." in explain(env, "jump")
    finally:
        del type(env).jump


def test_lines_of_a_lane_move_with_the_robot_and_stay_in_the_lane():

    for x in (0.0, 0.3, 7.9, -123.4):
        lines = lane_lines(np.array([x, 0.2]), 0.8)
        assert np.abs(lines[:, :, 0]).max() == pytest.approx(0.8)
        across = lines[lines[:, 0, 0] == lines[:, 1, 0]][:-2]
        places = (across[:, 0, 0] + x) * 2
        np.testing.assert_allclose(places, places.round(), atol=1e-3)


FALL = """
<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .1" mass="2"/></body>
</worldbody></mujoco>
"""


def test_arrows_show_velocity_and_contact_forces():

    model = mujoco.MjModel.from_xml_string(FALL)
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    arrows = contact_forces(model, data, 1.0)
    assert (arrows[:, 1] - arrows[:, 0]).sum(0) == pytest.approx([0, 0, 2 * 9.81], abs=0.1)
    short = shortened(arrows, 0.5)
    np.testing.assert_allclose(short[:, 1] - short[:, 0], [[0, 0, 0.5]] * len(arrows), atol=0.01)
    np.testing.assert_array_equal(shortened(arrows, 1e3), arrows)
    data.qvel[:] = [1, 2, 3, 0, 0, 0]
    data.qpos[3:7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # a quarter turn to the left
    mujoco.mj_forward(model, data)
    assert velocity(model, data, 1) == pytest.approx([1, 2, 3])
    assert heading(data, 1) @ [1, 0] == pytest.approx([0, 1, 0], abs=1e-6)
    assert heading(data, 1) @ [0, 1] == pytest.approx([-1, 0, 0], abs=1e-6)


@pytest.mark.parametrize("direction", [(0.0, -1.0, 0.2), (3.0, 1.0, 2.0)])
@pytest.mark.parametrize("width", [1.0, 4.0])
def test_robots_fit_into_the_picture_and_users_keep_their_direction(direction, width):

    view = SimpleNamespace(
        image_width=640, image_height=800, position=np.array(direction), look_at=np.zeros(3)
    )
    camera.fit(SimpleNamespace(camera=view), 1.0, width, keep_direction=True)
    sight = view.position - view.look_at
    assert sight / np.linalg.norm(sight) == pytest.approx(direction / np.linalg.norm(direction))
    visible = 2 * np.linalg.norm(sight) * np.tan(camera.FIELD / 2) * 640 / 800
    assert width < visible < max(1.5 * width, 2.8)
    camera.fit(SimpleNamespace(camera=view), 1.0, width, keep_direction=False)
    assert view.position[0] == 0 and view.position[1] < 0


@pytest.mark.parametrize("width", [1.0, 2.15])
def test_a_phone_shows_robots_and_their_names_above_its_sheet(width):

    view = SimpleNamespace(
        image_width=390, image_height=844, position=np.array([0.0, -1.0, 0.0]), look_at=np.zeros(3)
    )
    camera.fit(SimpleNamespace(camera=view), 1.0, width, keep_direction=True)
    visible = 2 * np.linalg.norm(view.position - view.look_at) * np.tan(camera.FIELD / 2)
    heights = np.array([ABOVE, 0.0]) - view.look_at[2]  # of a name and of the ground
    top, bottom = 0.5 - heights / visible  # as shares of the picture from its upper end
    assert 0.03 < top < bottom < camera.FREE
