"""The six tasks match the paper: states, observations, rewards and failures, step by step."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from acting import random_actions
from same import reference
from torch import Tensor

from morlax_torch import MorlaxError, envs

TOLERANCE = 1e-9
PUBLISHED = {  # the robot of each task, and the name of its rewards among the reference's arrays
    "cheetah": ("cheetah", "reward_cheetah2"),
    "cheetah3": ("cheetah", "reward_cheetah3"),
    **{name: (name, "reward") for name in ("walker", "hopper", "ant", "humanoid")},
}


def make(task: str, backend: str = "mujoco", worlds: int = 2, **options) -> envs.Environment:
    return envs.make(task, worlds, "cpu", backend=backend, **options)


def stacked(frames: list[Tensor]) -> np.ndarray:
    """Stack frames to (S, T, ...) as in the reference, one world per seed."""
    return torch.stack(frames, 1).numpy()


def assert_equal(actual: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(actual, expected, rtol=0, atol=TOLERANCE)


class Replay(NamedTuple):
    """A task's states, observations and rewards under the reference actions."""

    published: dict[str, np.ndarray]
    rewarded: np.ndarray  # published rewards (S, T, m)
    qpos: list[Tensor]  # starting at the reset
    qvel: list[Tensor]
    observations: list[Tensor]
    rewards: list[Tensor]  # starting at the first step
    failed: list[Tensor]
    steps: list[envs.TimeStep]


@pytest.fixture(scope="module", params=PUBLISHED)
def replay(request: pytest.FixtureRequest) -> Replay:
    robot, rewards = PUBLISHED[request.param]
    published, env = reference(robot), make(request.param, auto_reset=False)
    shown = Replay(published, published[rewards], [], [], [], [], [], [])

    def record() -> None:
        shown.qpos.append(env.physics.qpos.clone())
        shown.qvel.append(env.physics.qvel.clone())
        shown.observations.append(env.observe())

    env.reset()
    record()
    for action in torch.from_numpy(published["action"]).float().unbind(1):
        step = env.step(action)
        record()
        shown.rewards.append(env.combine(step.terms))
        shown.failed.append(env.failed())
        shown.steps.append(step)
    return shown


def test_trajectories_match_the_published_ones(replay):
    assert_equal(stacked(replay.qpos), replay.published["qpos"])
    assert_equal(stacked(replay.qvel), replay.published["qvel"])
    assert_equal(stacked(replay.observations), replay.published["obs"])
    assert_equal(stacked(replay.rewards), replay.rewarded)
    terminated = stacked([step.terminated for step in replay.steps])
    for failures in (stacked(replay.failed), terminated):
        assert (failures == replay.published["terminated"]).all()


def test_reward_terms_match_the_published_ones(replay):
    names = replay.published["term_names"]
    assert set(replay.steps[0].terms) == set(names)
    for name in names:
        term = stacked([step.terms[name] for step in replay.steps])
        assert_equal(term, replay.published[f"term_{name}"])


def test_every_built_in_task_is_compared_with_the_paper():
    elsewhere = {"bruce"}  # in test_bruce_task.py
    assert {name for name in envs.names() if "/" not in name} - elsewhere == set(PUBLISHED)


@pytest.mark.parametrize(
    ("task", "coordinate", "allowed", "failing"),
    [
        ("cheetah", 2, math.radians(49.9), math.radians(50)),
        ("cheetah", 2, math.radians(-49.9), math.radians(-50)),
        ("walker", 1, 0.81, 0.8),
        ("walker", 1, 1.99, 2.0),
        ("walker", 2, 0.99, 1.0),
        ("walker", 2, -0.99, -1.0),
        ("hopper", 1, 0.2, 0.19),
        ("hopper", 2, math.radians(269), math.radians(271)),
        ("hopper", 2, math.radians(-269), math.radians(-271)),
        ("humanoid", 2, 0.6, 0.59),
    ],
)
def test_a_robot_fails_beyond_the_published_limits(task, coordinate, allowed, failing):
    env = make(task)
    env.physics.qpos[:, coordinate] = torch.tensor([allowed, failing], dtype=torch.float64)
    assert env.failed().tolist() == [False, True]


def test_an_ant_fails_one_step_after_tilting_too_far():
    env = make("ant", auto_reset=False)
    still = torch.zeros(2, env.action_size)
    for world, up in enumerate((0.46, 0.44)):
        half = math.acos(up) / 2
        env.physics.qpos[world, 3:7] = torch.tensor([math.cos(half), math.sin(half), 0.0, 0.0])
    assert env.failed().tolist() == [False, False]
    assert env.step(still).terminated.tolist() == [False, True]


def test_the_cheetah_s_run_reward_saturates_at_four_meters_per_second():
    env = make("cheetah", auto_reset=False)
    env.physics.qvel[:, 0] = torch.tensor([3.5, 6.0])
    slow, fast = env.step(torch.zeros(2, env.action_size)).terms["run"].tolist()
    assert slow == pytest.approx(3.5, abs=0.1)
    assert fast == 4.0


@pytest.mark.parametrize("task", PUBLISHED)
def test_a_task_exposes_objectives_and_limits_and_steps_obey_them(task, backend):
    env = make(task, backend, worlds=3)
    assert (env.num_worlds, env.device, env.episode_length) == (3, torch.device("cpu"), 500)
    assert env.dt == pytest.approx(0.01)
    assert env.objectives == tuple(env.options.objectives)
    assert env.reference_point == (0.0,) * len(env.objectives)
    for weighted in (env.options.shared, *env.options.objectives.values()):
        assert set(weighted) <= set(env.reward_terms)
    first = env.reset()
    robot, rewards = PUBLISHED[task]
    expected = reference(robot)[f"reset_{rewards}"]
    np.testing.assert_allclose(env.paper_reset_reward(), expected, rtol=1e-6)
    step = env.step(torch.zeros(3, env.action_size))
    for value in (first, step.observation, step.final_observation):
        assert (value.shape, value.dtype) == ((3, env.observation_size), torch.float32)
    assert (step.reward.shape, step.reward.dtype) == ((3, len(env.objectives)), torch.float32)
    for flag in (step.terminated, step.truncated):
        assert (flag.shape, flag.dtype) == ((3,), torch.bool)
    assert tuple(step.terms) == env.reward_terms
    assert all(term.shape == (3,) for term in step.terms.values())


@pytest.mark.parametrize(
    ("task", "objectives", "shared"),
    [
        ("walker", {"fast": {"run": 3.0}, "thrifty": {"energy": 0.1}}, {}),
        (
            "cheetah",
            {"run": {"run": 1.0}, "save": {"energy": 0.5, "run": -0.25}, "rise": {"height": 2.0}},
            {"alive": 0.1, "energy": -0.3},
        ),
    ],
)
def test_objectives_are_the_configured_weighted_sums(task, objectives, shared):
    point = tuple(range(-1, len(objectives) - 1))
    env = make(task, objectives=objectives, shared=shared, reference_point=point)
    assert env.objectives == tuple(objectives)
    assert env.reference_point == tuple(map(float, point))
    for action in random_actions(env, 5):
        step = env.step(action)
        for column, group in enumerate(objectives.values()):
            expected = sum(
                weight * step.terms[name]
                for weighted in (group, shared)
                for name, weight in weighted.items()
            )
            assert_equal(env.combine(step.terms)[:, column], expected)
            np.testing.assert_allclose(step.reward[:, column], expected, rtol=1e-6, atol=1e-6)


def test_a_wrong_option_is_explained():
    with pytest.raises(MorlaxError, match=r"unknown reward term .* Known: alive, energy, run\."):
        make("walker", shared={"rnu": 1.0})
    sentence = "reference_point has 3 numbers, but there are 2 objectives: run, energy."
    with pytest.raises(MorlaxError, match=sentence):
        make("walker", reference_point=(0, 0, 0))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("chetah", 1, "cpu"), "unknown environment 'chetah': did you mean 'cheetah'? Known: ant,"),
        (("walker", 1, "cpu", "mujuco"), "unknown backend 'mujuco': did you mean 'mujoco'?"),
        (("walker", 1, 1.5), "1.5 is not a device: use 'cuda', 'cuda:1' or 'cpu'."),
        (("walker", 1.5, "cpu"), "num_worlds is 1.5: it must be an integer."),
        (("walker", 1, "cpu", None, -1), "seed is -1: it must be from 0 to 2^64 - 1."),
        (("walker", 2**31 - 1, "cpu", "warp"), "cannot hold 2147483647 worlds with task.nconmax"),
    ],
)
def test_a_wrong_argument_is_explained(arguments, sentence):
    with pytest.raises(MorlaxError) as caught:
        envs.make(*arguments)
    assert sentence in str(caught.value)


def test_the_cpu_default_backend_is_c_mujoco():
    assert type(envs.make("hopper", 1, "cpu").physics).__name__ == "MujocoPhysics"
    assert type(make("hopper", "warp", worlds=1).physics).__name__ == "WarpPhysics"
