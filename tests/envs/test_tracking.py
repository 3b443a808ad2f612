"""Tracking tasks of mjlab: motions from files, quantities, and a run that follows one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from calm import calm
from motions import g1, squat, write_motion, write_squat
from recordable import check_recordable, check_recorded_step
from tiny import FEW, learner, tiny

from morlax_torch import MorlaxError, envs
from morlax_torch.configuration.files import task_values
from morlax_torch.envs.bridges.mjlab import following
from morlax_torch.envs.bridges.mjlab import worlds as mjlab_worlds
from morlax_torch.envs.bridges.mjlab.following import landing_impact
from morlax_torch.envs.bridges.mjlab.motion import arrays, prepared
from morlax_torch.envs.bridges.mjlab.step import MaskedStep
from morlax_torch.envs.errors import MorlaxWarning
from morlax_torch.runs.choosing import choose
from morlax_torch.runs.loading import load_front
from morlax_torch.train import train

pytest.importorskip("mjlab", reason="needs the extra mjlab")

G1 = "mjlab:Mjlab-Tracking-Flat-Unitree-G1"
TWIN = f"{G1}-No-State-Estimation"
ERRORS = ("body error (mm)", "global body error (mm)", "end-effector error (mm)")


@pytest.fixture
def motion(tmp_path) -> Path:
    return write_squat(tmp_path / "squat.npz")


def loaded(path: Path, fps: float = 30.0) -> dict[str, np.ndarray]:
    """Read a motion as worlds with 50 control steps per second do."""
    from mjlab.asset_zoo.robots import get_g1_robot_cfg

    file, _ = prepared(path, path.stat().st_mtime_ns, fps, 0.0, 50.0, get_g1_robot_cfg().spec_fn)
    return dict(np.load(file))


def write_csv(path: Path, qpos: np.ndarray) -> Path:
    order = [0, 1, 2, 4, 5, 6, 3, *range(7, qpos.shape[1])]  # w is the last of the quaternion
    np.savetxt(path, qpos[:, order], delimiter=",")
    return path


def make(motion: Path, worlds: int = 4, **options) -> envs.Worlds:
    usual = {"episode_length": 50, "motion_file": str(motion), "motion_stand": 0.0}
    usual |= {"auto_reset": False}
    return envs.make(TWIN, worlds, "cpu", **{**usual, **options})


def test_a_reference_that_is_shifted_by_10_mm_is_10_mm_away_in_the_world_alone(motion):
    env = make(motion)
    command, everyone = env.env.command_manager.get_term("motion"), torch.arange(4)
    command.reset_to_frame(everyone, 30)
    env.env.sim.forward()
    command.motion.body_pos_w[..., 0] += 0.01
    command.update_relative_body_poses()
    env._measures.look()
    means, falls = env.measure().numpy(), np.full(4, 0.002)
    found = dict(zip(env.quantities, env.quantify(means, falls).T, strict=True))
    assert (found["falls (per 1,000 steps)"] == 2).all()
    for name, error in zip(ERRORS, (0, 10, 0), strict=True):
        np.testing.assert_allclose(found[name], error, atol=0.01)
    np.testing.assert_allclose(found["joint velocity error (rad/s)"], 0, atol=1e-4)


def test_the_last_frame_lasts_for_two_seconds(motion):
    short, longer = (
        make(motion, motion_stand=seconds).env.command_manager.get_term("motion").motion
        for seconds in (0.0, 2.0)
    )
    frames = short.time_step_total
    assert longer.time_step_total == frames + 100
    assert torch.equal(longer.joint_pos[frames:], longer.joint_pos[frames - 1].expand(100, -1))
    assert not longer.joint_vel[frames:].any() and longer.joint_vel[: frames - 1].any()


def test_a_foot_that_takes_the_whole_weight_in_one_step_is_an_impact_of_one(motion):
    env = make(motion)
    model, forces = env.env.sim.mj_model, env.env.scene["end_effector_contact"].data.force_history
    assert forces.shape == (4, 4, 5, 3)  # hands and feet, and a control step of 4 after an earlier
    forces[:] = 0.0
    forces[1, 0, 2:4, 2] = model.body_mass.sum() * 9.81
    forces[2, 0, 4, 2] = model.body_mass.sum() * 9.81  # was there before
    env.env.episode_length_buf += 2
    torch.testing.assert_close(landing_impact(env.env), torch.tensor([0.0, 1.0, 0.0, 0.0]))


def test_evaluated_episodes_of_every_trade_off_start_at_the_same_frames(motion):
    env = make(motion, 32)
    assert env.follows_part and not make(motion, episode_length=99).follows_part
    command = env.env.command_manager.get_term("motion")
    env.share_draws(torch.arange(32) % 8, 8)
    seen = env.reset().reshape(4, 8, -1)
    assert torch.equal(seen, seen[:1].expand_as(seen))
    frames = command.time_steps.clone()
    env.reseed(1)
    env.reset()
    assert torch.equal(frames, command.time_steps)
    gaps = frames[:8].sort().values.diff()
    assert gaps.min() > 0 and gaps.max() < 13  # of 50 frames that an episode may start at
    assert frames.max() + 50 <= command.motion.time_step_total
    # mjlab's even draws include the last frame, beyond which a step must not go
    command._uniform_sampling = lambda worlds: command.time_steps.index_fill_(0, worlds, 99)
    env.env.episode_length_buf.fill_(49)
    env.step(torch.zeros(32, env.action_size))
    assert (command.time_steps == 99).all()


@pytest.fixture
def clips(tmp_path) -> Path:
    """A folder with a motion of 2 s, one of 3 s, and a file of another kind."""
    (tmp_path / "clips").mkdir()
    write_squat(tmp_path / "clips/a.npz")
    write_csv(tmp_path / "clips/b.csv", squat(3.0, 30))
    (tmp_path / "clips/README.md").write_text("Two squats.")
    return tmp_path / "clips"


def test_motions_of_a_folder_are_followed_each_to_its_end(clips):
    env = make(clips, 8, auto_reset=True)
    command, action = env.env.command_manager.get_term("motion"), torch.zeros(8, env.action_size)
    frames = command.time_steps
    assert command.motion.time_step_total == 249  # 100 at the control rate, and 149
    frames[:] = 98
    env.step(action)
    assert (frames == 99).all()
    env.step(action)  # mjlab alone would go on to the first frame of the other motion
    assert len(frames.unique()) > 1
    pose = command.robot_body_pos_w - command.body_pos_w
    assert pose.norm(dim=-1).max() < 0.5  # but for what mjlab disturbs starts by
    command._adaptive_sampling = lambda worlds: frames.index_fill_(0, worlds, 99)
    env.env.episode_length_buf.fill_(49)
    env.step(action)  # new episodes start at the last frame of a motion, and stay there
    assert (frames == 99).all()
    env.share_draws(torch.arange(8), 8)
    env.reset()
    ends = torch.where(frames < 100, 100, 249)
    assert (frames + 50 < ends + 1).all() and len(ends.unique()) == 2


def test_the_current_folder_is_followed_only_if_it_is_named(clips, monkeypatch):
    monkeypatch.chdir(clips)
    with pytest.raises(MorlaxError, match="follows a motion: name its file"):
        make("")


def pair(motion: Path, device: str) -> tuple[Any, Any]:
    """Return two environments of mjlab that push robots alike; one episode and one motion end."""

    def follow(cfg: Any) -> None:
        cfg.commands["motion"].motion_file = str(motion)
        following.add_terms(cfg)

    options = {"pushed": True, "edit": follow, "episode_length_s": 3.0}
    own, ours = (calm(G1, 3, device, **options) for _ in range(2))
    for env in (own, ours):
        env.episode_length_buf.copy_(torch.tensor([0, 30, 145]))  # of 150 steps
        frames = env.command_manager.get_term("motion").time_steps
        frames.copy_(torch.tensor([0, 85, 90]))  # of 100
    return own, ours


def test_a_step_that_can_be_recorded_equals_mjlab_s(motion, generator):
    own, ours = pair(motion, "cpu")
    step = MaskedStep(ours, ("actor", "critic"))
    ended = torch.zeros(2, 3, dtype=torch.bool)
    for _ in range(40):
        action = 0.1 * torch.randn(3, 29, generator=generator)
        groups, _, terminated, timed_out, _ = own.step(action)
        seen, _, failed, late = step(action)
        assert torch.equal(groups["actor"], seen["actor"])
        assert torch.equal(groups["critic"], seen["critic"])
        assert torch.equal(own.reward_manager._step_reward, ours.reward_manager._step_reward)
        assert torch.equal(terminated, failed) and torch.equal(timed_out, late)
        ended |= torch.stack([terminated, timed_out])
    assert ended.tolist() == [[True, False, False], [False, False, True]]
    frames = [env.command_manager.get_term("motion").time_steps for env in (own, ours)]
    assert torch.equal(*frames) and 20 < frames[0][1] < 40  # the second motion began anew


def test_rollouts_and_evaluations_can_be_recorded(motion, monkeypatch):
    few = {**FEW, "worlds": 14, "sampling.clusters": 7, "task.motion_file": str(motion)}
    check_recordable(tiny(G1, backend=None, **few), monkeypatch)


@pytest.mark.gpu
def test_a_recorded_step_follows_mjlab_s(motion, generator):
    own, ours = pair(motion, "cuda")
    check_recorded_step(own, ours, 30, generator)
    frames = [env.command_manager.get_term("motion").time_steps for env in (own, ours)]
    assert torch.equal(*frames)


@pytest.mark.gpu
def test_recorded_rollouts_and_evaluations_follow_a_motion(motion, tmp_path):
    few = {"worlds": 1024, "sampling.clusters": 8, "max_env_steps": 10**5, "device": "cuda"}
    few |= {"evaluation.tradeoffs": 8, "task.motion_file": str(motion), "horizon": 24}
    front = load_front(train(tiny(G1, backend=None, **few), output=tmp_path / "run").folder)
    assert 0 < front.quantities[:, 0].min() < 300


def test_failures_are_counted_as_in_mjlab_and_draw_episodes_to_their_frames(motion, monkeypatch):
    counts = []
    for masked in (False, True):
        monkeypatch.setattr(mjlab_worlds, "supported", lambda *_, answer=masked: answer)
        env = make(motion, 128, auto_reset=True)
        command, simulation = env.env.command_manager.get_term("motion"), env.env.sim
        command.reset_to_frame(torch.arange(128), 10)
        command.time_steps[40:] = 60
        simulation.data.qpos[20:60, 2] -= 1.0  # m
        for _ in range(1 if masked else 2):  # mjlab counts what it has restarted in the next step
            env.step(torch.zeros(128, env.action_size))
        counts.append(command.bin_failed_count / command.cfg.adaptive_alpha)
    torch.testing.assert_close(*counts)
    assert counts[0][0] >= 20 and counts[0][1] >= 20

    command.bin_failed_count[:] = torch.tensor([0.0, 0.2, 0.6])  # of a motion of 2 s
    env.env.episode_length_buf.fill_(env.episode_length - 1)
    assert env.step(torch.zeros(128, env.action_size)).truncated.float().mean() > 0.5
    seconds = (command.time_steps - 1) * 3 // 99
    shares = torch.bincount(seconds, minlength=3) / 128
    expected = torch.tensor([0.18, 0.3, 0.52])  # half is drawn evenly, and 0.1 of mjlab's counts
    torch.testing.assert_close(shares, expected, rtol=0, atol=0.12)


@pytest.mark.parametrize("masked", [False, True])
def test_a_resumed_run_keeps_its_counts_of_failures(motion, masked, monkeypatch):
    monkeypatch.setattr(mjlab_worlds, "supported", lambda *_: masked)
    resumed = learner(tiny(G1, backend=None, **FEW, **{"task.motion_file": str(motion)}))
    command = resumed.env.env.command_manager.get_term("motion")
    command.bin_failed_count[:] = counts = torch.arange(5.0)
    state = resumed.state_dict()
    command.bin_failed_count.zero_()
    resumed.load_state_dict(state)
    assert torch.equal(command.bin_failed_count, counts)
    resumed.load_state_dict({**state, "environment": {"levels": []}})  # of an earlier version
    resumed.iterate()
    assert command.bin_failed_count.sum() > 9


def test_forward_kinematics_and_velocities_are_those_of_mujoco(motion):
    ours, its = arrays(squat(), 50.0, g1()), np.load(motion)
    assert ours.keys() | {"fps"} == set(its.files)
    for name, values in ours.items():  # velocities of a point and differences of its places differ
        np.testing.assert_allclose(values, its[name], atol=0.02 if "vel" in name else 1e-6)


def test_a_csv_file_and_another_frame_rate_make_the_same_motion(motion, tmp_path):
    its = np.load(motion)
    quick = write_squat(tmp_path / "60.npz", fps=60)
    for path in (write_csv(tmp_path / "squat.csv", squat(fps=100)), quick):
        ours = loaded(path, 100.0)
        assert ours["fps"] == 50 and len(ours["joint_pos"]) in (99, 100)
        for name, values in ours.items():
            vel = 0.06 if "vel" in name else 2e-3
            np.testing.assert_allclose(values[:99], its[name][:99], atol=vel, err_msg=name)
    assert all((loaded(motion)[name] == its[name]).all() for name in its.files)
    np.savetxt(tmp_path / "w_first.csv", squat(), delimiter=",")
    with pytest.warns(MorlaxWarning, match="upside down: is its quaternion w x y z"):
        loaded(tmp_path / "w_first.csv", 50.0)


def changed(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray | None]) -> Path:
    """Write the squat with another array, or without it."""
    motion = dict(np.load(write_squat(folder / "bad.npz")))
    motion[name] = change(motion[name])
    np.savez(folder / "bad.npz", **{key: x for key, x in motion.items() if x is not None})
    return folder / "bad.npz"


def jump(folder: Path, row: int, column: int, size: float) -> Path:
    qpos = squat()
    qpos[row:, column] += size
    return write_csv(folder / "bad.csv", qpos)


BAD = {
    "23 joints and 30 bodies, and th": lambda p: changed(p, "joint_pos", lambda x: x[:, :23]),
    "lacks body_quat_w: a motion in": lambda p: changed(p, "body_quat_w", lambda x: None),
    "needs as many frames of joint_pos,": lambda p: changed(p, "body_pos_w", lambda x: x[:9]),
    "and a number in fps: write": lambda p: changed(p, "fps", lambda x: x[:0]),
    "lacks fps: a motion in mjlab's": lambda p: changed(p, "fps", lambda x: None),
    "says 25 frames .* about 50: correct": lambda p: changed(p, "fps", lambda x: x / 2),
    "jumps after frame 39, at 60 rad/s if it has 30": lambda p: jump(p, 40, 12, 2.0),
    "jumps after frame 39, at 60 m/s .*most 20 are": lambda p: jump(p, 40, 0, 2.0),
    "not finite in frame 7": lambda p: jump(p, 7, 20, np.nan),
    "not of length one": lambda p: jump(p, 0, 3, 1.0),
    "35 columns, .* 36: x y z": lambda p: write_csv(p / "bad.csv", squat()[:, :-1]),
    "is empty: a motion has at": lambda p: write_csv(p / "bad.csv", squat()[:0]),
    "is neither a CSV nor an npz file": lambda p: Path(__file__),
    "episode-length 39, or less": lambda p: write_motion(p / "bad.npz", squat()[:40], 50),
    "and .*/other.npz is no file: name its .* and keep it there": lambda p: p / "other.npz",
    "State-Estimation follows a motion: name its file": lambda p: "",
    "follows a motion, and .* has none: name its file": lambda p: p,
}


@pytest.mark.parametrize("sentence", BAD)
def test_bad_motions_are_refused_in_a_sentence(sentence, tmp_path):
    with pytest.raises(MorlaxError, match=sentence):
        make(BAD[sentence](tmp_path))


def test_a_family_of_seven_objectives_is_trained_and_chosen_from(motion, tmp_path):
    given = task_values(TWIN, "cpu")
    assert given["task"] == task_values(G1, "cpu")["task"]
    few = {"worlds": 14, "sampling.clusters": 7, "max_env_steps": 112, "evaluation.every": 56}
    few |= {"evaluation.tradeoffs": 8, "task.motion_file": str(motion)}
    config = tiny(TWIN, backend=None, **few)
    front = load_front(train(config, output=tmp_path / "run").folder)
    assert front.objectives == tuple(given["task"]["objectives"])
    errors = front.quantities[:, front.quantity_names.index(ERRORS[0])]
    assert (errors > 1).all() and (errors < 300).all()
    limit = float(np.median(errors))
    choice = choose(front, {}, maximize="effort", at_most={ERRORS[0]: limit})
    assert choice.quantities[ERRORS[0]] <= limit
