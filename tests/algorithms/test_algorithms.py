"""Every algorithm finds a front that is known in closed form, and does what its paper says."""

import copy
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import torch
from closed_form import STEPS, Quadratic, Sprint, best_returns
from same import assert_same
from tiny import iterate, tiny
from tiny import learner as learner_of
from torch.testing import assert_close

from morlax_torch import MORLAX, MorlaxError, config_for, load, save
from morlax_torch.algorithms import methods
from morlax_torch.algorithms.batch import make_batch
from morlax_torch.algorithms.methods import AMOR, HyperMORL
from morlax_torch.algorithms.registry import LEARNERS
from morlax_torch.algorithms.rollout import Rollout
from morlax_torch.commands.train import command
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.sections import PPOConfig
from morlax_torch.configuration.tradeoffs import even_tradeoffs, sample_cells
from morlax_torch.envs import make
from morlax_torch.evaluation.front import Front
from morlax_torch.networks.family import Independent
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.training import make_evaluator
from morlax_torch.train import train

TASK = f"{Path(__file__).parents[1] / 'closed_form.py'}:{Quadratic.__name__}"
WORLDS, HORIZON, CLUSTERS = 64, 4, 8
SMALL: dict[str, Any] = {
    "device": "cpu",
    "worlds": WORLDS,
    "horizon": HORIZON,
    "sampling.clusters": CLUSTERS,
    "network.actor": (16,),
    "network.critic": (16,),
    "network.hidden": (16,),
    "ppo.learning_rate": 3e-3,
    "ppo.entropy": 0.0,
    "ppo.minibatches": 2,
    "evaluation.tradeoffs": 11,
}
SCALAR: dict[str, Any] = {"ppo.critic": "scalar", "ppo.optimizer": "joint"}
SPARSE: dict[str, Any] = {"sampling.mode": "sparse"}
LONGER = {"env": TASK.replace(Quadratic.__name__, Sprint.__name__)}  # than one step


@pytest.fixture(autouse=True)
def brief(constants) -> None:
    """Let hyper-sac begin to learn at once."""
    constants("hyper-sac", start=1)


def small(algorithm: str, iterations: int = 10, **changes: Any) -> Config:
    steps = iterations * WORLDS * HORIZON
    values = {**SMALL, "algorithm": algorithm, "max_env_steps": steps, **changes}
    if algorithm == "hyper-sac":
        values |= {"method.batch": 256, "method.updates": 8} | changes
    return config_for(values.pop("env", TASK), **values)


def trained(config: Config, iterations: int) -> Any:
    learner = learner_of(config)
    if config.device != "cpu":
        learner.compile()
    iterate(learner, iterations)
    return learner


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize(
    "algorithm",
    [pytest.param(name, marks=[pytest.mark.slow] * (name != "morlax")) for name in LEARNERS],
)
def test_it_finds_the_front(algorithm, device):
    iterations, changes = 60 if algorithm == "hyper-sac" else 100, {"ppo.learning_rate": 8e-3}
    if algorithm == "hyper-sac":
        changes |= {"method.learning_rate": 2e-3}
    learner = trained(small(algorithm, iterations, device=device, **changes), iterations)
    front = make_evaluator(learner).evaluate()
    tradeoffs = torch.as_tensor(front.tradeoffs)
    returns = torch.as_tensor(front.returns).float()
    if algorithm == "independent":  # the nearest of the grid's policies
        grid = even_tradeoffs(CLUSTERS, 2)
        tradeoffs = grid[torch.cdist(tradeoffs, grid).argmin(1)]
    regret = ((best_returns(tradeoffs) - returns) * tradeoffs).sum(1)
    assert regret.max() < 0.02
    assert_close(returns, best_returns(tradeoffs), rtol=0, atol=0.1)


@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [
        *(pytest.param(name, {}, id=name) for name in LEARNERS),
        pytest.param("morlax", SCALAR, id="as released"),
        pytest.param("amor", SPARSE, id="sparse amor"),
        pytest.param("hyper-sac", LONGER, id="hyper-sac, longer"),
    ],
)
def test_resuming_continues_exactly(algorithm, changes):
    config = small(algorithm, 8, **changes)  # HYPER-MORL's warm-up ends after one iteration
    whole, half = trained(config, 10), trained(config, 5)
    state = copy.deepcopy(half.state_dict())
    half.metrics()
    other = trained(config, 1)
    other.load_state_dict(state)
    for learner in (half, other):
        iterate(learner, 5)
    assert half.metrics() == other.metrics()
    ours, others = whole.state_dict(), other.state_dict()
    for part in ("agent", "optimizers"):
        assert_same(ours[part], others[part])


def test_a_state_of_one_world_is_not_copied_to_all():
    one, several = (trained(tiny(worlds=n, **{"sampling.mode": "dense"}), 0) for n in (1, 8))
    with pytest.raises(MorlaxError, match="the saved worlds are another number"):
        several.load_state_dict(one.state_dict())


@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [
        ("morlax", {"ppo.desired_kl": 0.01, "sampling.focus": (3.0, 1.0, 0.5)}),
        ("morlax", {"scalarization": "chebyshev", "sampling.alpha": 0.5}),
        ("morlax", {"env": "design/hopper", "sampling.designs": 2, "task.reset_noise": 0.01}),
        ("hyper-sac", {"method.updates": 4, "method.hold": 0.1}),
    ],
    ids=str,
)
def test_torch_s_defaults_change_no_number(algorithm, changes, dtypes):
    results = []
    for _ in dtypes:
        learner = trained(tiny(algorithm=algorithm, **changes), 3)
        front = make_evaluator(learner).evaluate()
        results.append([learner.state_dict(), learner.metrics(), front.returns.tolist()])
    assert_same(*results)


@pytest.mark.parametrize(
    "mode", [torch.no_grad, torch.inference_mode, partial(torch.autocast, "cpu", torch.bfloat16)]
)
def test_modes_of_torch_around_an_iteration_change_no_number(mode):
    plain, inside = (trained(tiny(), 0) for _ in range(2))
    plain.iterate()
    with mode():
        inside.iterate()
    assert_same(plain.state_dict(), inside.state_dict())


def test_draws_spread_from_the_focus_until_they_cover_the_simplex():
    learner = trained(small("morlax", 8, **{"sampling.focus": (3.0, 1.0, 0.5)}), 0)
    focus, farthest = torch.tensor([0.75, 0.25]), []
    for done in (0.0, 0.25, 0.5, 0.9):
        learner.iterate(done)
        assert_close(learner.tradeoffs.sum(1), torch.ones(CLUSTERS))
        farthest.append((learner.tradeoffs - focus).abs().max())
    # that is the corner of the second objective
    assert_close(torch.stack(farthest), torch.tensor([0.0, 0.375, 0.75, 0.75]))


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_policies_stay_as_they_are_at_the_end_of_a_decay(algorithm):
    few = {"method.updates": 4} if algorithm == "hyper-sac" else {}
    learner = trained(tiny(algorithm=algorithm, decay_fraction=0.5, **few), 1)
    tradeoffs, seen = torch.eye(2), torch.randn(2, 5, learner.env.observation_size)
    actions = []
    for _ in range(3):
        learner.iterate(1.0)
        actions.append(learner.agent.actors(tradeoffs).act(seen))
    assert torch.equal(actions[0], actions[2])


@pytest.mark.parametrize("algorithm", ["morlax", "hyper-sac"])
def test_alpha_moves_draws_to_the_corners_or_to_the_center(algorithm):
    farthest = []
    for alpha in (1e-3, 1.0, 1e6):
        changes = {"sampling.alpha": alpha, "sampling.cells": False, "sampling.corners": 0}
        learner = trained(small(algorithm, 8, **changes), 1)
        assert_close(learner.tradeoffs.sum(1), torch.ones(CLUSTERS))
        farthest.append((learner.tradeoffs - 0.5).abs().amax(1))
    assert farthest[0].min() > 0.49 and farthest[2].max() < 0.01
    assert 0.05 < farthest[1].mean() < 0.45


def test_hyper_morl_warms_up_at_the_balanced_tradeoff_and_then_starts_the_hypernetwork(monkeypatch):
    monkeypatch.setattr(methods, "WARMUP", 0.15)
    learner = trained(small("hyper-morl", 20), 3)
    assert isinstance(learner, HyperMORL) and learner.warming_up
    assert (learner.tradeoffs == 0.5).all() and learner.ppo.optimizers[0].mean.any()
    learner._start_hypernetwork()  # as the next iteration does first
    assert not learner.agent.actor.weight.any() and not learner.agent.critic.weight.any()
    assert not learner.ppo.optimizers[0].mean.any()
    seen, tradeoffs = torch.ones(2, 1, 1), torch.tensor([[0.9, 0.1], [0.5, 0.5]])
    both = learner.agent.actors(tradeoffs).act(seen)
    assert torch.equal(both[0], both[1])
    iterate(learner, 1)
    assert not learner.warming_up and learner.agent.actor.weight.any()
    cells = torch.cdist(learner.tradeoffs, even_tradeoffs(CLUSTERS, 2)).argmin(1)
    assert torch.equal(cells, torch.arange(CLUSTERS))


def test_collapsing_a_hypernetwork_keeps_one_tradeoff_s_network():
    learner = trained(small("morlax"), 3)
    actor, w = learner.agent.actor, torch.tensor([0.3, 0.7])
    before = actor.flat(w[None])
    actor.collapse(w)
    assert_close(actor.flat(torch.rand(4, 2)), before.expand(4, -1))


@pytest.mark.parametrize(("m", "steps"), [(2, 5), (3, 4)])
def test_cells_of_the_simplex_are_sampled_with_their_corners(m, steps, generator):
    grid = [point for point in product(range(steps + 1), repeat=m) if sum(point) == steps]
    centers, out, drawn = torch.tensor(grid) / steps, torch.zeros(len(grid), m), []
    for _ in range(800):
        sample_cells(out, centers, generator)
        drawn.append(out.clone())
    found = torch.stack(drawn)
    assert (found >= 0).all()
    assert_close(found.sum(-1), torch.ones(800, len(grid)))
    assert torch.equal(torch.cdist(found, centers).argmin(-1)[0], torch.arange(len(grid)))
    corners = (found > 1 - 1e-6).any(-1).float().mean(0)
    assert (corners.sort().values[-m:] > {2: 0.45, 3: 0.25}[m]).all()
    inner = (centers > 1.5 / steps).all(-1) if m == 2 else (centers > 0.9 / steps).all(-1)
    assert_close(found.mean(0)[inner], centers[inner], rtol=0, atol=0.02)


def test_hyper_morl_s_second_stage_starts_exploration_and_learning_rates_anew(monkeypatch):
    monkeypatch.setattr(methods, "WARMUP", 0.25)
    changes = {"decay_fraction": 1.0, "network.initial_std": 0.4}
    learner = trained(small("hyper-morl", 40, **changes), 0)
    rates, spreads = [], []
    seen = torch.ones(CLUSTERS, 1, 1)
    for _ in range(40):
        iterate(learner, 1)
        rates.append(learner.ppo.optimizers[0].rate.item())
        spreads.append(learner.agent.actors(learner.tradeoffs).distribution(seen).std)
    assert rates[:10] == pytest.approx([3e-3 * (1 - i / 10) for i in range(10)])
    assert rates[10:] == pytest.approx([3e-3 * (1 - i / 30) for i in range(30)])
    warm, after = (abs(std - 0.4).max() for std in spreads[9:11])
    assert warm > 0.2 and after < warm / 2
    learner._start_hypernetwork()
    std = learner.agent.actors(learner.tradeoffs).distribution(torch.randn(CLUSTERS, 5, 1)).std
    assert_close(std, torch.full_like(std, 0.4))


def test_amor_keeps_a_world_s_tradeoff_until_its_episode_ends():
    changes = {"task.episode_length": 10, "task.stagger": True}
    learner = trained(tiny(algorithm="amor", worlds=16, **changes), 1)
    assert isinstance(learner, AMOR) and len(learner.tradeoffs.unique(dim=0)) == 16
    kept = 0
    for _ in range(6):
        before, rollout = learner.tradeoffs.clone(), Rollout(*(x.clone() for x in learner.rollout))
        learner.iterate()
        ended = (rollout.terminated | rollout.truncated).any(0).squeeze(-1)
        same = (learner.tradeoffs == before).all(-1)
        assert torch.equal(same, ~ended)
        kept += same.sum().item()
    assert 0 < kept < 6 * 16


@pytest.mark.parametrize("worlds", [WORLDS, CLUSTERS])
def test_another_reward_of_one_tradeoff_changes_that_policy_alone(worlds, monkeypatch):
    monkeypatch.setattr(PPOConfig, "max_grad_norm", 0.1)
    config = small("independent", worlds=worlds, **{"ppo.minibatches": 1})
    one, other = trained(config, 0), trained(config, 0)
    for learner, change in ((one, 0.0), (other, 1.0)):
        learner.explore()
        learner.rollout.reward[:, 2] += change * torch.randn(HORIZON, worlds // CLUSTERS, 2)
        # the one thing they share
        learner.agent.value_normalizer.update = lambda *_, **__: None
        learner.learn()
    same = (one.agent.actor.rows == other.agent.actor.rows).all(1)
    assert same.tolist() == [True, True, False, *[True] * 5]


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_a_resumed_run_s_policies_still_return_what_was_measured(algorithm, tmp_path):
    """Loaded, saved without training's state and loaded again, and as the policy of a trade-off."""
    folder = train(small(algorithm, 6, **LONGER), output=tmp_path / "run").folder
    steps = 12 * WORLDS * HORIZON
    command(["--resume", str(folder), "--trust", "--max-env-steps", str(steps)])
    measured = Front.load(folder / "front.npz")
    save(load(folder, trust=True), tmp_path / "policies.pt")
    for path in (folder, tmp_path / "policies.pt"):
        policy = load(path, "cpu", trust=True)
        assert policy.config.algorithm == algorithm
        found = evaluate(policy, device="cpu")
        assert_close(found.returns, measured.returns, rtol=1e-5, atol=1e-5)
    for tradeoff, wanted in zip(measured.tradeoffs, measured.returns, strict=True):
        single, x, energy = policy.specialize(tradeoff.tolist()), 0.0, 0.0
        for step in range(STEPS):
            action = single(torch.tensor([[x, step / STEPS]])).item()
            x, energy = x + action / STEPS, energy + (1 - action**2) / STEPS
        assert [Sprint.far(torch.tensor(x)).item(), energy] == pytest.approx(wanted, abs=1e-4)


def test_the_network_of_the_nearest_key_is_chosen():
    keys = even_tradeoffs(1001, 2)
    family = Independent(torch.nn.Linear(1, 1), keys)
    assert torch.equal(family.chosen(keys), torch.arange(1001))


def test_a_scalar_critic_learns_the_weighted_reward():
    learner = trained(small("morlax", **SCALAR), 1)
    learner.explore()
    ppo, tradeoffs, rollout = learner.config.ppo, learner.tradeoffs, learner.rollout
    batch, explained = make_batch(learner.agent, tradeoffs, rollout, ppo, tradeoffs)
    earned = (rollout.reward * tradeoffs[:, None]).sum(-1, keepdim=True)  # in one step, all of it
    assert batch.target.shape == (CLUSTERS, WORLDS // CLUSTERS, HORIZON, 1)
    found = learner.agent.value_normalizer.inverse(batch.target)
    assert_close(found, earned.permute(1, 2, 0, 3))
    assert explained.shape == (1,) and "explained_variance/utility" in learner.metrics()


@pytest.mark.parametrize("number", [3, 6, 10, 40])
def test_even_tradeoffs_cover_the_simplex(number):
    points = even_tradeoffs(number, 3)
    assert_close(points.sum(1), torch.ones(number))
    assert_close(points[:3], torch.eye(3))
    assert len(points.unique(dim=0)) == number
    random = torch.distributions.Dirichlet(torch.ones(3)).sample((2000,))
    radius = torch.cdist(random, points).amin(1).max().item()
    assert radius < 1.6 / number**0.5  # a triangle of area 0.87 in `number` cells


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "sac"}, "algorithm.*'morlax', 'hyper-sac', 'amor'"),
        ({"algorithm": "amor", "network.type": "dual"}, "amor needs conditioned: leave it out"),
        (
            {"algorithm": "hyper-morl", "max_env_steps": None, "decay_fraction": 0.0},
            "needs max_env_steps or max_seconds",
        ),
        ({"algorithm": "hyper-sac", "scalarization": "chebyshev"}, "hyper-sac needs weighted sums"),
        (
            {"algorithm": "hyper-sac", "sampling.clusters": 8, "method.batch": 100},
            r"must be a multiple of 8 .sampling.clusters.: try --method.batch",
        ),
    ],
)
def test_bad_combinations_get_one_sentence(changes, message):
    with pytest.raises(MorlaxError, match=message) as caught:
        config_for("cheetah", device="cpu", **changes)
    assert "\n" not in str(caught.value)


SWAPPED = {"jump": {"jump": 12.0}, "run": {"run": 1.5}}  # as a dict, equal to those of the hopper


@pytest.mark.parametrize(
    ("worlds", "changes", "message"),
    [
        ({"num_worlds": 4}, {}, "4 worlds, but config.worlds is 8"),
        ({"auto_reset": False}, {}, "auto_reset=True"),
        ({"episode_length": 5}, {"task.objectives": SWAPPED}, "config.task in objectives: make"),
        ({}, {"algorithm": "hyper-morl"}, "for algorithm hyper-morl, but MORLAX is morlax"),
        ({}, {"task.shared": {"upright": 1}}, r"differ from config.task in shared, .*length: make"),
    ],
)
def test_worlds_and_configs_that_do_not_fit_morlax_are_refused(worlds, changes, message):
    env = make("hopper", **{"num_worlds": 8, "device": "cpu", **worlds})
    with pytest.raises(MorlaxError, match=message):
        MORLAX(env, tiny(**changes))


def test_learners_that_take_turns_in_the_same_worlds_see_them_as_they_are():
    config = tiny()
    env = config.make_worlds(config.worlds, config.seed)
    first, second = MORLAX(env, config), MORLAX(env, config)
    for learner in (first, second, second, first):
        observation = env.critic_observation()
        learner.iterate()
        assert_close(learner.rollout.observation[0].flatten(0, 1), observation)
    second.load_state_dict(second.state_dict())
    first.load_state_dict(first.state_dict())
    observation = env.critic_observation()
    second.iterate()
    assert_close(second.rollout.observation[0].flatten(0, 1), observation)


def test_an_algorithm_is_chosen_on_the_command_line_or_in_a_file(tmp_path):
    file = tmp_path / "amor.yaml"
    file.write_text("env: cheetah\nalgorithm: amor\n")
    with pytest.raises(MorlaxError, match=r"is for algorithm 'amor', but --algorithm says"):
        command(["--config", str(file), "--algorithm", "independent"])
