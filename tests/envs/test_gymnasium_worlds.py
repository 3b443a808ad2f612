"""Training works in any Gymnasium environment with vector rewards."""

import math
from functools import partial

import gymnasium
import mo_gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict, Discrete, Sequence, Space
from peers import check_run
from tiny import tiny

import morlax_torch
from morlax_torch import MorlaxError, envs
from morlax_torch.commands import evaluate, train
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import task_values
from morlax_torch.envs.devices import EVALUATION_SEEDS
from morlax_torch.runs.progress import read_rows
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


def point(**options) -> envs.Worlds:
    envs.register("point", envs.from_gymnasium(Point))
    return envs.make("point", 3, "cpu", **options)


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
    objectives = {"late": {"reward_0": -1.0}, "fuel": {"reward_0": 0.5, "reward_1": 2.0}}
    regrouped = envs.make(CAR, 2, "cpu", objectives=objectives, episode_length=50)
    assert regrouped.reference_point == (0.0, -2.5 * 50)  # rewards are from -1 to 0
    assert (worlds.observation_size, worlds.action_size, len(worlds.objectives)) == (2, 1, 2)
    assert worlds.dt == math.inf
    assert envs.make("gymnasium:mo-hopper-v5", 1, "cpu").dt == pytest.approx(0.008)
    assert point().objectives == ("reward_0", "reward_1")
    for name in (CAR, "point"):
        assert load_config(task_values(name, "cpu")).worlds == 64


def test_observations_are_flattened_and_actions_rescaled():
    worlds = point()
    start = worlds.reset()
    assert start.shape == (3, 3)  # place, and one-hot side
    step = worlds.step(torch.tensor([[-1.0], [0.0], [9.0]]))
    moved = step.terms["reward_0"] - start[:, 0]
    np.testing.assert_allclose(moved, [0.0, 0.25, 0.5], atol=1e-6)  # actions are clipped to the box


def test_torch_s_defaults_change_nothing(dtypes):
    worlds, action = point(), torch.ones(3, 1)
    rewards = []
    for _ in dtypes:
        worlds.reseed(0)
        worlds.reset()
        rewards.append(worlds.step(action).reward)
    assert torch.equal(*rewards)


def test_seeds_of_an_evaluation_suit_environments_of_32_bits():
    seeds = []

    class Narrow(Point):
        def reset(self, *, seed=None, options=None):
            if seed is not None:
                seeds.append(np.int32(seed))
            return super().reset(seed=seed)

    envs.register("narrow", envs.from_gymnasium(Narrow))
    for seed in (7, EVALUATION_SEEDS + 7):
        envs.make("narrow", 2, "cpu", seed=seed).reset()
    assert seeds[:2] == [7, 8] and len({*seeds}) == 4


@pytest.mark.parametrize(
    ("box", "least", "most"),
    [(Box(-0.6, 1.7, (1,)), -0.5, 1.6), (Box(0, 4, (1,), np.int32), 0, 4)],
)
def test_actions_reach_both_ends_of_a_box_and_stay_in_it(box, least, most):
    class Strict(Point):
        action_space = box

        def step(self, action):
            assert self.action_space.contains(action)
            return super().step(action)

    make = envs.from_gymnasium(Strict)
    worlds = make(make.Options(), 2, torch.device("cpu"))
    ends = torch.tensor([[-1.0], [1.0]])
    worlds.step(ends)
    spent = -worlds.step(0.95 * ends).terms["reward_1"]
    assert spent[0] <= least and spent[1] >= most


def test_auto_reset_starts_the_next_episode_in_the_same_step():
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


def test_without_auto_reset_a_finished_world_earns_nothing_and_stays_unchanged():
    worlds = point(auto_reset=False)
    worlds.reset()
    *_, before, last = [worlds.step(torch.ones(3, 1)) for _ in range(5)]
    assert last.terminated.all() and not last.truncated.any() and (last.reward == 0).all()
    assert torch.equal(last.observation, before.observation)


def test_episodes_are_truncated_at_their_length_and_objectives_regrouped():
    objectives = {"far": {"reward_0": 2.0}, "both": {"reward_0": 1.0, "reward_1": 1.0}}
    worlds = point(episode_length=4, objectives=objectives)
    worlds.reset()
    steps = [worlds.step(-torch.ones(3, 1)) for _ in range(8)]
    assert [step.truncated.all().item() for step in steps] == [False, False, False, True] * 2
    terms, reward = steps[0].terms, steps[0].reward
    assert torch.equal(reward[:, 0], 2 * terms["reward_0"])
    assert torch.equal(reward[:, 1], terms["reward_0"] + terms["reward_1"])


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
    return make(make.Options(), 2, torch.device("cpu"))


ZEROS = np.zeros(3)
DICT = Dict({"a": Box(-1, 1, (3,))})


def answer(seen=ZEROS, reward=(0, 0), terminated=False):
    return {"answer": (seen, reward, terminated, False, {})}


WRONG = [  # members of an environment, and part of the error
    ({"start": ZEROS}, "reset() -> (observation, info) fails: ValueError: too many values"),
    ({"start": (ZEROS,)}, "not enough values to unpack"),
    ({"start": (0.5, {})}, "an observation of shape (), not (3,)"),
    ({"start": ("left", {})}, "fails: ValueError: could not convert"),
    ({"start": (ZEROS * np.nan, {})}, "not finite in float32"),
    (
        {"observation_space": DICT, "start": ({"b": ZEROS}, {})},
        "reset() -> (observation, info) fails: KeyError: 'a'",
    ),
    ({"answer": None}, "step() -> (observation, reward, terminated, truncated, info) fails"),
    ({"answer": (ZEROS, np.zeros(2), False, {})}, "not enough values to unpack"),
    (answer(reward=1.0), "a reward of shape (), not (2,)"),
    (answer(reward={"a": 1}), "TypeError: float() argument must be"),
    (answer(terminated=np.zeros(2, bool)), "truth value of an array"),
    (answer(ZEROS[:1]), "an observation of shape (1,), not (3,)"),
]


@pytest.mark.parametrize(("members", "sentence"), WRONG)
def test_answers_that_do_not_fit_the_spaces_are_one_sentence(members, sentence):
    with pytest.raises(MorlaxError) as caught:
        worlds = plain(**members)
        worlds.reset()
        worlds.step(torch.zeros(2, 2))
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


INFINITE = [
    answer(reward=(1e39, 0)),
    answer(reward=(np.nan, 0)),
    answer(ZEROS - 1e39),
    {"answer": (ZEROS + np.nan, (0, 0), False, True, {})},
]


@pytest.mark.parametrize("members", INFINITE)
def test_numbers_that_float32_cannot_hold_end_the_episode_with_zero_reward(members):
    worlds = plain(**members)
    worlds.reset()
    step = worlds.step(torch.zeros(2, 2))
    assert step.terminated.all() and not step.truncated.any() and step.blown_up.all()
    assert worlds.blowups == 2
    assert (step.reward == 0).all() and (step.final_observation == 0).all()


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
        ("gymnasium:deep-sea-treasure-v0", r"actions that are not continuous \(Discrete\(4\)\)"),
        ("gymnasium:Pendulum-v1", "has no vector reward"),
        ("gymnasium:no-such-thing-v0", "Gymnasium cannot make 'no-such-thing-v0'"),
        ("gymnasium:nowhere:thing-v0", "Gymnasium cannot make 'nowhere:thing-v0'"),
        ("gymnasium:.here:thing-v0", "Gymnasium cannot make '.here:thing-v0': TypeError"),
        ("gymnasium:failing_module:thing-v0", "cannot make .*: ZeroDivisionError: division by"),
    ],
)
def test_unsupported_environments_are_rejected(name, sentence, tmp_path, monkeypatch):
    (tmp_path / "failing_module.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MorlaxError, match=sentence):
        envs.get(name)


@pytest.mark.parametrize(
    ("member", "space", "sentence"),
    [
        ("action_space", Box(-np.inf, np.inf, (1,)), "give its Box a low and a high"),
        ("reward_space", Box(-1, 1, ()), "has no vector reward"),
        ("observation_space", Sequence(Box(-1.0, 1.0, (2,))), "observations without a fixed size"),
        ("observation_space", Dict({"a": Sequence(Discrete(2))}), "without a fixed size"),
        ("observation_space", Dict({}), "has empty observations"),
        ("observation_space", None, "observations without a fixed size"),
    ],
)
def test_unsupported_spaces_are_rejected(member, space, sentence):
    with pytest.raises(MorlaxError, match=sentence):
        envs.from_gymnasium(type("Other", (Point,), {member: space}))


def test_a_batch_or_nothing_in_place_of_one_environment_is_one_sentence():
    batch = gymnasium.vector.SyncVectorEnv([partial(gymnasium.make, "Pendulum-v1")])
    for made, name in ((batch, "SyncVectorEnv"), (None, "NoneType")):
        with pytest.raises(MorlaxError, match=f"must return one gymnasium.Env, not {name}"):
            envs.from_gymnasium(lambda made=made: made)


def test_worlds_that_would_share_an_environment_are_refused():
    one = Point()
    make = envs.from_gymnasium(lambda: gymnasium.wrappers.TimeLimit(one, 9), "points")
    with pytest.raises(MorlaxError, match="points: its worlds share one environment"):
        make(make.Options(), 2, torch.device("cpu"))


def test_gymnasium_worlds_run_only_on_the_cpu():
    with pytest.raises(MorlaxError, match="runs only on the CPU"):
        envs.make(CAR, 2, "cpu", "warp")


def test_a_run_is_trained_evaluated_loaded_and_resumed(tmp_path, capsys, refused):
    run = tmp_path / "run"
    changes = {"task.episode_length": 100, "task.reference_point": (-101.0, -101.0)}
    check_run(tiny(CAR, backend=None, **changes), run, capsys)
    assert all(float(row["hypervolume"]) > 0 for row in read_rows(run / "metrics.csv"))
    with pytest.raises(MorlaxError, match="has no MuJoCo robot"):
        Player(morlax_torch.load(run), (0.5, 0.5))

    error = f"the protocol paper goes on after a failure, but episodes of '{CAR}' end there: choose"
    paper, other = ("--evaluation.protocol", "paper"), tmp_path / "other"
    assert error in refused(train, "--env", CAR, *paper, "--output", other)
    assert not other.exists()
    before = (run / "config.yaml").read_text()
    assert error in refused(train, "--resume", run, *paper)
    assert error in refused(evaluate, run, "--protocol", "paper")
    assert (run / "config.yaml").read_text() == before
