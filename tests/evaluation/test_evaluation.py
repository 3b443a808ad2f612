"""Evaluations measure the returns of deterministic policies under each protocol."""

from typing import Any

import numpy as np
import pytest
import torch
from acting import episode
from same import assert_same
from tiny import tiny
from torch import nn

from morlax_torch import MorlaxError, envs
from morlax_torch.configuration.tradeoffs import even_tradeoffs
from morlax_torch.envs import TimeStep
from morlax_torch.evaluation import evaluator as module
from morlax_torch.evaluation.evaluator import (
    Evaluator,
    evaluation_worlds,
    make_evaluator,
    usual_tradeoffs,
)
from morlax_torch.evaluation.front import Front, mean_indicators
from morlax_torch.gpu.group import ALONE, Group
from morlax_torch.networks.agent import Agent

# Published returns of zero actions, including the reward at the reset.
IDLE = {
    "cheetah": (501.8, 2505.0),
    "walker": (119.8, 615.0),
    "hopper": (35.7, 137.6),
    "ant": (2506.0, 2506.0),
    "humanoid": (170.4, 588.0),
}


@pytest.mark.parametrize("task", IDLE)
def test_zero_actions_reproduce_the_published_returns(make_agent, task):
    env = envs.make(task, 2, "cpu", "mujoco", auto_reset=False)
    agent = make_agent(env.observation_size, env.action_size)
    with torch.no_grad():
        for parameter in agent.actor.parameters():
            parameter.zero_()
    front = Evaluator(agent, env, torch.eye(2), "paper").evaluate()
    np.testing.assert_allclose(front.returns, [IDLE[task]] * 2, rtol=0.01)


class Scripted:
    """Worlds whose rewards, failures and recoveries follow a script, regardless of actions."""

    REWARD = torch.tensor([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0], [8.0, 80.0]])  # by step
    FAILED = torch.tensor(
        [[False, False, False, False], [False, True, False, False], [False, False, True, True]]
    )  # by world and step
    quantities, titles, dt = (), {"jump": "height"}, 0.1

    def __init__(self, auto_reset: bool = False):
        self.auto_reset, self.num_worlds, self.device = auto_reset, 3, torch.device("cpu")
        self.observation_size, self.action_size, self.episode_length = 3, 2, 4
        self.objectives, self.reference_point = ("run", "jump"), (0.5, 5.0)
        self.generator = torch.Generator()
        self.bits = torch.zeros(3, dtype=torch.int32)

    def reset(self) -> torch.Tensor:
        self.t = 0
        return self.seen()

    def reseed(self, seed: int) -> None:
        self.generator.manual_seed(seed)

    def share_draws(self, episodes: torch.Tensor, number: int) -> None:
        assert episodes.tolist() == [0, 0, 0] and number == 2

    def move_only(self, which: torch.Tensor) -> None:
        self.moving = which.clone()

    def seen(self) -> torch.Tensor:
        return torch.full((3, 3), float(self.t))

    def step(self, action: torch.Tensor) -> TimeStep:
        reward, failed = self.REWARD[self.t].expand(3, 2), self.FAILED[:, self.t]
        reward = torch.where(self.moving[:, None], reward, torch.nan)
        self.t += 1
        truncated = torch.full((3,), self.t >= 4) & ~failed
        seen = self.seen()
        return TimeStep(seen, reward, failed, truncated, seen, {}, seen, seen)

    def overflow(self) -> torch.Tensor:
        return self.bits

    def remedy(self, bits: int) -> str:
        return f"raise {bits}"

    def paper_reset_reward(self) -> torch.Tensor:
        return torch.tensor([100.0, 1000.0])


TRADEOFFS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7]])


@pytest.fixture
def agent(make_agent) -> Agent:
    agent = make_agent()
    agent.observation_normalizer.update(torch.tensor([[0.0, 1.0, 2.0], [3.0, 5.0, 7.0]]))
    return agent


def test_the_latched_protocol_counts_steps_up_to_the_first_failure(agent):
    evaluator = Evaluator(agent, Scripted(), TRADEOFFS)
    for _ in range(2):  # an evaluator can be reused
        front = evaluator.evaluate()
        assert front.returns.tolist() == [[15, 150], [3, 30], [7, 70]]
        assert front.lengths.tolist() == [4, 2, 3]
        assert front.falls.tolist() == [0, 1, 1]
    assert front.objectives == ("run", "jump")
    assert front.reference_point.tolist() == [0.5, 5.0]
    np.testing.assert_array_equal(front.tradeoffs, TRADEOFFS)
    assert front.hypervolume == pytest.approx(14.5 * 145)


def test_the_paper_s_protocol_masks_only_the_failed_steps(agent):
    front = Evaluator(agent, Scripted(), TRADEOFFS, "paper").evaluate()
    assert front.returns.tolist() == [[115, 1150], [113, 1130], [103, 1030]]
    assert front.falls.tolist() == [0, 1, 1]


def test_the_paper_s_protocol_goes_on_after_all_have_failed(agent, monkeypatch):
    class Stumble(Scripted):
        FAILED = torch.tensor([[False, True, False, False]] * 3)

    monkeypatch.setattr(module, "STEPS_PER_GRAPH", 1)
    front = Evaluator(agent, Stumble(), TRADEOFFS, "paper").evaluate()
    assert front.returns.tolist() == [[113, 1130]] * 3
    latched = Stumble()
    assert Evaluator(agent, latched, TRADEOFFS).evaluate().returns.tolist() == [[3, 30]] * 3
    assert latched.t == 2  # nothing follows


def test_the_discounted_protocol_ends_with_the_failure_or_its_own_time_limit(agent, monkeypatch):
    discounted = Evaluator(agent, Scripted(), TRADEOFFS, "discounted")
    for _ in range(2):
        front = discounted.evaluate()
        whole = 1 + 2 * 0.99 + 4 * 0.99**2 + 8 * 0.99**3
        expected = [whole, 1 + 2 * 0.99, 1 + 2 * 0.99 + 4 * 0.99**2]
        np.testing.assert_allclose(front.returns[:, 0], expected, rtol=1e-6)
        np.testing.assert_allclose(front.returns[:, 1], 10 * front.returns[:, 0], rtol=1e-6)
    assert front.reference_point.tolist() == [-100, -100]
    monkeypatch.setattr(module, "HORIZON", 3)
    front = Evaluator(agent, Scripted(), TRADEOFFS, "discounted").evaluate()
    assert front.lengths.tolist() == [3, 2, 3] and front.returns[0, 0] == pytest.approx(expected[2])


def test_published_tables_have_their_own_number_of_trade_offs_unless_training_has_one():
    latched, discounted = tiny(), tiny(**{"evaluation.protocol": "discounted"})
    found = [usual_tradeoffs(config, "discounted") for config in (latched, discounted)]
    assert found == [1024, 4]
    assert usual_tradeoffs(discounted, "latched") == 4


def test_what_happens_after_an_episode_is_over_does_not_count(agent):
    class Late(Scripted):
        """The first world truncates itself after two steps; all blow up in the last one."""

        def step(self, action: torch.Tensor) -> TimeStep:
            step = super().step(action)
            truncated = step.truncated | torch.tensor([self.t >= 2, False, False])
            return step._replace(truncated=truncated, blown_up=torch.full((3,), self.t == 4))

    front = Evaluator(agent, Late(), TRADEOFFS).evaluate()
    assert front.returns.tolist() == [[3, 30], [3, 30], [7, 70]]
    assert front.lengths.tolist() == [2, 2, 3]
    assert front.falls.tolist() == [0, 1, 1] and front.blowups.tolist() == [0, 0, 0]


@pytest.mark.parametrize(("task", "length"), [("hopper", 500), ("cheetah3", 20)])
def test_returns_equal_those_of_single_worlds_stepped_by_hand(task, length, make_agent):
    env = envs.make(task, 3, "cpu", "mujoco", auto_reset=False, episode_length=length)
    m = len(env.objectives)
    agent = make_agent(env.observation_size, env.action_size, m, scale=1.0)
    tradeoffs = torch.eye(3) if m == 3 else TRADEOFFS
    evaluator = Evaluator(agent, env, tradeoffs)
    with torch.no_grad():
        agent.actor.bias += 0.3  # evaluations use the agent's current parameters
    before = {name: value.clone() for name, value in agent.state_dict().items()}
    front = evaluator.evaluate()
    assert_same(dict(agent.state_dict()), before)
    assert all(p.requires_grad and p.grad is None for p in agent.parameters())
    assert front.objectives == env.objectives
    for k, tradeoff in enumerate(tradeoffs):
        alone = envs.make(task, 1, "cpu", "mujoco", episode_length=length)
        actor = nn.Sequential(agent.observation_normalizer, agent.actor.specialize(tradeoff))
        returns, steps = episode(alone, lambda x, run=actor: run(x).chunk(2, -1)[0].tanh())
        assert front.lengths[k] == steps
        assert (steps < length) == (task == "hopper")  # every hopper falls
        np.testing.assert_allclose(front.returns[k], returns, rtol=1e-3)
    assert len(np.unique(front.returns, axis=0)) == 3


def test_worlds_rest_unless_they_are_to_move():
    env = envs.make("hopper", 4, "cpu", "mujoco", auto_reset=False)
    some = torch.tensor([True, False, True, False])
    for which in (some, ~some, torch.zeros_like(some), torch.ones_like(some)):
        env.move_only(which)
        before = env.physics.qpos.clone()
        env.step(torch.zeros(4, env.action_size))
        assert (env.physics.qpos != before).any(1).tolist() == which.tolist()


@pytest.mark.parametrize(
    ("task", "options"),
    [("hopper", {}), ("walker", {"randomization": {"mass": (0.5, 2), "action_delay": (0, 3)}})],
)
def test_worlds_rest_after_their_episode_which_changes_no_return(task, options, make_agent):
    found, steps = [], 0
    for rests in (False, True):
        env = envs.make(task, 8, "cpu", "mujoco", auto_reset=False, episode_length=200, **options)
        agent = make_agent(env.observation_size, env.action_size, scale=1.0)
        agent.actor.bias.data += 0.3  # every robot falls
        evaluator, step = Evaluator(agent, env, even_tradeoffs(8, 2)), env.step
        if not rests:
            env.move_only = lambda which: None

        def counted(action, step=step):
            nonlocal steps
            steps += 1
            return step(action)

        env.step = counted
        found.append([evaluator.evaluate() for _ in range(2)])
    for front in (*found[0], *found[1]):
        np.testing.assert_array_equal(front.returns, found[0][0].returns)
        np.testing.assert_array_equal(front.lengths, found[0][0].lengths)
    longest = front.lengths.max()
    assert front.lengths.min() < longest < 190
    assert 4 * longest <= steps <= 4 * (longest + 4)  # steps go in groups of five


@pytest.fixture
def front() -> Front:
    return Front(
        objectives=("run", "jump"),
        tradeoffs=TRADEOFFS.numpy(),
        returns=np.array([[4.0, 1.0], [1.0, 4.0], [1.0, 1.0]]),
        lengths=np.array([500, 80, 7]),
        reference_point=np.array([0.5, 0.0]),
        falls=np.array([0.0, 0.5, 1.0]),
    )


def test_a_front_computes_its_indicators(front):
    assert front.non_dominated.tolist() == [True, True, False]
    assert front.hypervolume == pytest.approx(3.5 + 1.5)
    expected = {
        "hypervolume": 5.0,
        "sparsity": 18.0,
        "expected_utility": (4 + 4 + 0.3 + 2.8) / 3,
        "cardinality": 2,
        "obedience": 2 / 3,  # the third policy's utility is 1.0, the best available is 3.1
        "fall_rate": 0.5,
    }
    assert front.indicators() == pytest.approx(expected)
    found = front.indicators([[4, 1], [1, 5]])
    assert found["igd_plus"] == pytest.approx((0 + 1) / 2)


RANDOM = {
    "starts": ("cheetah", {"reset_noise": 0.1}),
    "models": ("cheetah", {"randomization": {"friction": (0.5, 2), "mass": (0.5, 2)}}),
    "noise": ("cheetah", {"randomization": {"observation_noise": {"velocity": 0.1}}}),
    "delays and pushes": ("ant", {"randomization": {"action_delay": (0, 3), "push": 1.0}}),
    "bruce": ("bruce", {"noise": 1.0, "randomize": True, "draw_commands": True, "redraw_every": 7}),
    "gymnasium": ("gymnasium:mo-hopper-v5", {}),
}


def evaluator_of(case: str, make_agent, seeds: int, sets: int, group: Group = ALONE) -> Evaluator:
    """Return an evaluator of 16 trade-offs that share one policy.

    With fewer worlds, some fall into the rest of a vectorized loop, which rounds differently.
    """
    name, options = RANDOM[case]
    number = 16 * seeds * sets // group.size
    backend = None if name.startswith("gymnasium") else "mujoco"
    common = {"auto_reset": False, "episode_length": 20}
    env = envs.make(name, number, "cpu", backend, **common, **options)
    agent = make_agent(env.observation_size, env.action_size, len(env.objectives))
    torch.nn.init.zeros_(agent.actor.weight)
    tradeoffs = torch.eye(len(env.objectives))[8 * [0, 1]]
    return Evaluator(agent, env, tradeoffs, seeds=seeds, sets=sets, group=group)


@pytest.mark.parametrize("case", RANDOM)
def test_the_same_policy_gets_the_same_returns_under_every_trade_off(case, make_agent):
    """And others in other episodes: only the episode decides about the draws."""
    first, second = evaluator_of(case, make_agent, 2, 2).evaluate_sets()
    within = 1e-4 if case == "bruce" else 0.0  # its rows are summed in different orders
    for front in (first, second):
        np.testing.assert_allclose(front.returns, front.returns[16 * [0]], rtol=within)
    assert not np.allclose(first.returns, second.returns, rtol=1e-6)
    (alone,) = evaluator_of(case, make_agent, 2, 1).evaluate_sets()
    np.testing.assert_array_equal(alone.returns, first.returns)


class Shared(envs.get("hopper")):
    """Worlds that draw from torch's own generator, as mjlab's do on a GPU."""

    def prepare_starts(self, seed: int) -> Any:
        self.generator = torch.default_generator.manual_seed(seed)
        self.draws.generator = self.generator
        return super().prepare_starts(seed)


def test_an_evaluator_leaves_training_worlds_their_draws(make_agent):
    agent, config = make_agent(13, 4), tiny(f"{__file__}:Shared", **{"task.reset_noise": 0.01})
    training = config.make_worlds(4, seed=3)
    state = training.generator.get_state()
    evaluator = make_evaluator(agent, config)
    assert torch.equal(training.generator.get_state(), state)
    evaluator.evaluate()
    assert torch.equal(training.generator.get_state(), state)


class Half(Group):
    """One of two processes; the first one gets what the second one has gathered before."""

    size = 2
    other: np.ndarray

    def __init__(self, rank: int):
        self.rank = rank

    def gather(self, value: np.ndarray) -> list[np.ndarray]:
        if self.rank:
            Half.other = value
        return [value, Half.other]


@pytest.mark.parametrize("case", ["starts", "models", "noise"])
def test_several_processes_run_the_same_episodes_as_one(case, make_agent):
    expected = evaluator_of(case, make_agent, 1, 2).evaluate_sets()
    for rank in (1, 0):
        fronts = evaluator_of(case, make_agent, 1, 2, Half(rank)).evaluate_sets()
    for found, whole in zip(fronts, expected, strict=True):
        np.testing.assert_allclose(found.returns, whole.returns, rtol=1e-6)


@pytest.mark.parametrize("protocol", ("latched", "paper", "discounted"))
def test_a_fall_on_the_last_step_counts(agent, protocol):
    env = Scripted()
    env.FAILED = torch.tensor([[False, False, False, failed] for failed in (True, False, False)])
    front = Evaluator(agent, env, TRADEOFFS, protocol).evaluate()
    assert front.falls.tolist() == [1, 0, 0]


def test_a_mean_number_of_policies_is_rounded(front):
    fronts = [front, front, front._replace(returns=np.zeros((3, 2)))]  # 2, 2 and 1
    assert mean_indicators(fronts)["cardinality"] == 2


def test_a_front_can_be_saved_and_loaded(front, tmp_path):
    path = tmp_path / "front.npz"
    front.save(path)
    again = Front.load(path)
    assert again.objectives == front.objectives and again.blowups is None
    for name in ("tradeoffs", "returns", "lengths", "reference_point", "falls"):
        np.testing.assert_array_equal(getattr(again, name), getattr(front, name))
    with np.load(path) as arrays:
        assert arrays["non_dominated"].tolist() == [True, True, False]
        assert "blowups" not in arrays
    front._replace(blowups=np.array([0.0, 0.5, 1.0])).save(path)
    assert Front.load(path).blowups.tolist() == [0, 0.5, 1]
    cost = np.array([[1.0], [np.nan], [np.inf]])
    front._replace(quantities=cost, quantity_names=("cost",)).save(path)
    np.testing.assert_array_equal(Front.load(path).quantities, cost)
    with pytest.raises(MorlaxError, match="cannot write"):
        front.save(tmp_path / "nowhere" / "front.npz")


def test_a_contact_overflow_makes_an_evaluation_fail(make_agent):
    env = Scripted()
    evaluator = Evaluator(make_agent(), env, torch.eye(2)[[0, 1, 0]])
    env.bits[1] = 4
    with pytest.raises(MorlaxError, match=r"overflowed their buffers in an evaluation: raise 4"):
        evaluator.evaluate()


def test_an_evaluation_has_an_episode_for_each_process():
    group = Group()
    group.rank, group.size = 7, 8
    with pytest.raises(MorlaxError, match="2 episodes, fewer than the 8 processes of this run"):
        evaluation_worlds(tiny(), 2, 1, group=group)
