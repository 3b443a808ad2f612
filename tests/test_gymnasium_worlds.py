"""Training works in any Gymnasium environment with vector rewards."""

import csv
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import gymnasium
import mo_gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict, Discrete, Graph, Sequence, Space

import morlax_torch
from morlax_torch import MorlaxError, envs
from morlax_torch.commands import evaluate as evaluate_command
from morlax_torch.commands import train
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import task_values
from morlax_torch.runs.evaluating import evaluate
from morlax_torch.viewers.player import Player

CAR = "gymnasium:mo-mountaincarcontinuous-v0"
pytestmark = pytest.mark.filterwarnings("ignore:.*precision lowered by casting")


class Point(gymnasium.Env):
    """A point on a line that moves right or stays; it fails beyond 1."""

    observation_space = Dict({"place": Box(-9.0, 9.0, (1,)), "side": Discrete(2)})
    action_space = Box(np.array([0.0], np.float32), np.array([0.5], np.float32))
    reward_space = Box(-np.inf, np.inf, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-0.1, 0.1)
        return self._seen(), {}

    def step(self, action):
        self.x += float(action[0])
        return self._seen(), np.array([self.x, -action[0]]), self.x > 1.0, False, {}

    def _seen(self):
        return {"place": np.array([self.x], np.float32), "side": int(self.x > 0)}


@pytest.fixture
def point(monkeypatch: pytest.MonkeyPatch) -> Callable[..., envs.Worlds]:
    def make(worlds: int = 3, **options) -> envs.Worlds:
        monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
        envs.registry._REGISTRY.pop("point", None)
        envs.register("point", envs.from_gymnasium(Point))
        return envs.make("point", worlds, "cpu", **options)

    return make


def test_worlds_match_the_original_environment_step_by_step():
    worlds = envs.make(CAR, 2, "cpu", seed=5)
    originals = [mo_gymnasium.make("mo-mountaincarcontinuous-v0") for _ in range(2)]
    first = [original.reset(seed=5 + i)[0] for i, original in enumerate(originals)]
    np.testing.assert_array_equal(worlds.reset(), first)
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        action = torch.rand(2, 1, generator=generator) * 2 - 1
        step = worlds.step(action)
        for world, original in enumerate(originals):
            seen, reward, terminated, truncated, _ = original.step(action[world].numpy())
            np.testing.assert_array_equal(step.observation[world], seen)
            np.testing.assert_allclose(step.reward[world], reward, rtol=1e-6)
            assert (step.terminated[world], step.truncated[world]) == (terminated, truncated)


def test_worlds_expose_objectives_spaces_and_limits():
    worlds = envs.make(CAR, 2, "cpu")
    assert worlds.objectives == ("reward_0", "reward_1")
    assert worlds.episode_length == 999
    assert worlds.reference_point == (-999.0, -999.0)  # the lowest reward on every step
    assert (worlds.observation_size, worlds.action_size, len(worlds.objectives)) == (2, 1, 2)
    assert worlds.overflow().tolist() == [0, 0]


@pytest.mark.parametrize(("task", "dt"), [("gymnasium:mo-hopper-v5", 0.008), (CAR, math.inf)])
def test_control_steps_last_as_long_as_the_environment_says(task, dt):
    assert envs.make(task, 1, "cpu").dt == pytest.approx(dt)


def test_observations_are_flattened_and_actions_rescaled(point):
    worlds = point()
    start = worlds.reset()
    assert start.shape == (3, 3)  # place, and one-hot side
    step = worlds.step(torch.tensor([[-1.0], [0.0], [9.0]]))
    moved = step.terms["reward_0"] - start[:, 0]
    np.testing.assert_allclose(moved, [0.0, 0.25, 0.5], atol=1e-6)  # actions are clipped to the box


def test_auto_reset_starts_the_next_episode_in_the_same_step(point):
    worlds = point(auto_reset=True)
    worlds.reset()
    fast, still = torch.ones(3, 1), -torch.ones(3, 1)
    steps = [worlds.step(fast) for _ in range(3)]
    failed = [step.terminated for step in steps]
    assert torch.stack(failed).sum(0).tolist() == [1, 1, 1]  # after two steps of 0.5, or three
    for step in steps:
        over = step.terminated
        assert (step.final_observation[over, 0] > 1.0).all()
        assert (step.observation[over, 0].abs() <= 0.1).all()
        assert torch.equal(step.observation[~over], step.final_observation[~over])
    assert (worlds.step(still).reward[:, 1] == 0).all()


def test_without_auto_reset_a_finished_world_stays_unchanged(point):
    worlds = point(auto_reset=False)
    worlds.reset()
    steps = [worlds.step(torch.ones(3, 1)) for _ in range(5)]
    assert steps[-1].terminated.all()
    assert (steps[-1].reward == 0).all()
    assert torch.equal(steps[-1].observation, steps[-2].observation)
    assert not worlds.step(torch.ones(3, 1)).truncated.any()


def test_episodes_are_truncated_at_their_length(point):
    worlds = point(episode_length=4)
    worlds.reset()
    truncated = [worlds.step(-torch.ones(3, 1)).truncated.all().item() for _ in range(8)]
    assert truncated == [False, False, False, True] * 2


def test_objectives_can_be_regrouped(point):
    objectives = {"far": {"reward_0": 2.0}, "both": {"reward_0": 1.0, "reward_1": 1.0}}
    worlds = point(objectives=objectives)
    worlds.reset()
    step = worlds.step(torch.zeros(3, 1))
    assert torch.equal(step.reward[:, 0], 2 * step.terms["reward_0"])
    assert torch.equal(step.reward[:, 1], step.terms["reward_0"] + step.terms["reward_1"])


class Plain(gymnasium.Env):
    """An environment whose answers a test replaces."""

    observation_space: Space = Box(-9.0, 9.0, (3,))
    action_space = Box(-1.0, 1.0, (2,))
    reward_space = Box(-np.inf, np.inf, (2,))
    start: tuple = np.zeros(3), {}
    answer: tuple = np.zeros(3), np.zeros(2), False, False, {}

    def reset(self, *, seed=None, options=None):
        return self.start

    def step(self, action):
        return self.answer


def plain(**members) -> envs.Worlds:
    """Return two worlds of `Plain` with other members."""
    changed = type("Changed", (Plain,), members)
    make = envs.from_gymnasium(changed, "changed")
    return make(make.Options(), 2)


ZEROS = np.zeros(3)
WRONG_STARTS = {
    "no tuple": ({"start": ZEROS}, "reset() must return a tuple (observation, info)"),
    "a short tuple": ({"start": (ZEROS,)}, "not a tuple of 1"),
    "one number": ({"start": (0.5, {})}, "observation of shape (), but its observation_space"),
    "a row": ({"start": (np.zeros((1, 3)), {})}, "of shape (1, 3)"),
    "words": ({"start": ("left", {})}, "does not fit its observation_space Box"),
    "not finite": ({"start": (ZEROS * np.nan, {})}, "not finite in float32"),
    "a missing part": (
        {"observation_space": Dict({"a": Box(-1, 1, (3,))}), "start": ({"b": ZEROS}, {})},
        "reset() returned an observation that does not fit its observation_space Dict",
    ),
}
WRONG_STEPS = {
    "no tuple": (None, "step() must return a tuple (observation, reward, terminated, truncated"),
    "the old four": ((ZEROS, np.zeros(2), False, {}), "not a tuple of 4"),
    "one reward": ((ZEROS, 1.0, False, False, {}), "a reward of shape (), but reward_space"),
    "a long reward": ((ZEROS, np.zeros(3), False, False, {}), "a reward of shape (3,)"),
    "a named reward": ((ZEROS, {"a": 1}, False, False, {}), "must return a reward of numbers"),
    "two ends": ((ZEROS, np.zeros(2), np.zeros(2, bool), False, {}), "as True or False"),
    "a short observation": ((ZEROS[:1], np.zeros(2), False, False, {}), "of shape (1,)"),
}


WRONG = WRONG_STARTS | {
    f"a step: {name}": ({"answer": answer}, sentence)
    for name, (answer, sentence) in WRONG_STEPS.items()
}


@pytest.mark.parametrize(("members", "sentence"), WRONG.values(), ids=WRONG)
def test_answers_that_do_not_fit_the_spaces_are_one_sentence(members, sentence):
    with pytest.raises(MorlaxError) as caught:
        worlds = plain(**members)
        worlds.reset()
        worlds.step(torch.zeros(2, 2))
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(2,), (1, 2)])
def test_actions_of_another_shape_are_one_sentence(shape):
    worlds = plain()
    worlds.reset()
    with pytest.raises(MorlaxError, match=r"step needs actions of shape \(2, 2\)"):
        worlds.step(torch.zeros(shape))


@pytest.mark.parametrize(
    "answer",
    [
        (ZEROS, np.array([1e39, 0.0]), False, False, {}),
        (ZEROS, np.array([np.nan, 0.0]), False, False, {}),
        (ZEROS - 1e39, np.zeros(2), False, False, {}),
        (ZEROS + np.nan, np.zeros(2), False, True, {}),
    ],
)
def test_numbers_that_float32_cannot_hold_end_the_episode_with_zero_reward(answer):
    worlds = plain(answer=answer)
    worlds.reset()
    step = worlds.step(torch.zeros(2, 2))
    assert step.terminated.all() and not step.truncated.any() and step.blown_up.all()
    assert worlds.blowups == 2
    assert (step.reward == 0).all() and (step.final_observation == 0).all()


@pytest.mark.parametrize(
    "space",
    [
        Sequence(Box(-1.0, 1.0, (2,))),
        Graph(Box(-1.0, 1.0, (2,)), None),
        Dict({"a": Sequence(Discrete(2))}),
        Dict({}),
        None,
    ],
)
def test_observations_need_a_fixed_size(space):
    with pytest.raises(MorlaxError, match=r"changed has (empty observations|observations without)"):
        plain(observation_space=space)


@pytest.mark.parametrize("method", ["reset", "step", "__init__"])
@pytest.mark.parametrize("error", [SystemExit("bye"), KeyError("knee")])
def test_an_environment_that_fails_is_one_sentence_with_its_line(method, error):
    made = []

    def fail(self, *arguments, **named):
        made.append(self)
        if method != "__init__" or len(made) > 1:  # the first one only shows its spaces
            raise error

    with pytest.raises(MorlaxError, match=f"changed: .* fails: {type(error).__name__}") as caught:
        worlds = plain(**{method: fail})
        worlds.reset()
        worlds.step(torch.zeros(2, 2))
    assert method == "__init__" or f"{__file__}, line " in str(caught.value)
    assert caught.value.__cause__ is error


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("gymnasium:deep-sea-treasure-v0", "actions that are not continuous (Discrete(4))"),
        ("gymnasium:Pendulum-v1", "has no vector reward"),
        ("gymnasium:no-such-thing-v0", "Gymnasium cannot make 'no-such-thing-v0'"),
        ("gymnasium:nowhere:thing-v0", "Gymnasium cannot make 'nowhere:thing-v0'"),
        ("gymnasium:.here:thing-v0", "Gymnasium cannot make '.here:thing-v0': TypeError"),
    ],
)
def test_unsupported_environments_are_rejected(name, sentence):
    with pytest.raises(MorlaxError) as caught:
        envs.get(name)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("member", "space", "sentence"),
    [
        ("action_space", Box(-np.inf, np.inf, (1,)), "give its Box a low and a high"),
        ("reward_space", Box(-1, 1, ()), "has no vector reward"),
    ],
)
def test_unbounded_actions_and_single_rewards_are_rejected(member, space, sentence):
    with pytest.raises(MorlaxError, match=sentence):
        envs.from_gymnasium(type("Other", (Point,), {member: space}))


def test_a_module_that_fails_is_one_sentence(tmp_path, monkeypatch):
    (tmp_path / "failing_module.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MorlaxError, match=r"cannot make .*: ZeroDivisionError: division by zero"):
        envs.get("gymnasium:failing_module:thing-v0")


def test_gymnasium_worlds_reject_the_warp_backend():
    with pytest.raises(MorlaxError, match="runs only on the CPU"):
        envs.make(CAR, 2, "cpu", "warp")


def test_gymnasium_environments_share_one_config():
    config = load_config(task_values(CAR, "cpu"))
    assert config.env == CAR
    assert config.worlds == 64
    assert config.task.episode_length == 999


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "car"
    train.command(
        f"--env {CAR} --device cpu --worlds 16 --horizon 16 --ppo.minibatches 2 "
        "--decay-fraction 0 --max-env-steps 1500 --evaluation.every 700 "
        f"--evaluation.tradeoffs 4 --task.episode-length 100 --output {folder}".split()
    )
    return folder


def test_a_run_measures_the_hypervolume_and_its_policies_can_be_evaluated(run):
    with (run / "metrics.csv").open(newline="") as file:
        volumes = [float(row["hypervolume"]) for row in csv.DictReader(file)]
    assert len(volumes) >= 3 and np.isfinite(volumes).all() and volumes[-1] > 0
    policy = morlax_torch.load(run)
    assert policy(torch.zeros(3, 2), (0.5, 0.5)).shape == (3, 1)
    front = evaluate(policy, 4, device="cpu")
    assert front.returns.shape == (4, 2)
    assert (front.returns >= -100).all()


def test_a_protocol_that_goes_on_after_failures_is_refused(run, tmp_path, refused):
    error = f"the protocol paper goes on after a failure, but episodes of '{CAR}' end there: choose"
    paper, folder = ("--evaluation.protocol", "paper"), tmp_path / "run"
    assert error in refused(train, "--env", CAR, *paper, "--output", folder)
    assert not folder.exists()
    before = (run / "config.yaml").read_text()
    assert error in refused(train, "--resume", run, *paper)
    assert error in refused(evaluate_command, run, "--protocol", "paper")
    assert (run / "config.yaml").read_text() == before


def test_the_worlds_of_a_resumed_gymnasium_run_start_anew(run, tmp_path, capsys):
    run = shutil.copytree(run, tmp_path / "run")
    train.command(["--resume", str(run), "--max-env-steps", "3000"])
    assert "they start anew" in capsys.readouterr().out


def test_a_player_needs_a_mujoco_robot(run):
    with pytest.raises(MorlaxError, match="has no MuJoCo robot"):
        Player(morlax_torch.load(run), (0.5, 0.5))
