"""Scalarizations turn returns into one utility, and learners follow its gradient."""

import numpy as np
import pytest
import torch
from closed_form import Concave, Quadratic, Sphere, Sprint, covered
from numpy.testing import assert_allclose
from same import assert_same

from morlax_torch import MORLAX, MorlaxError, config_for, envs
from morlax_torch.algorithms.batch import expected_returns
from morlax_torch.algorithms.registry import make_learner
from morlax_torch.algorithms.scalarizations import (
    AUGMENTATION,
    FORGETTING,
    LEVELS,
    MOST,
    RATE,
    SMOOTHNESS,
    Constrained,
    SmoothChebyshev,
    make_scalarization,
)
from morlax_torch.configuration.tradeoffs import evaluation_tradeoffs
from morlax_torch.evaluation import pareto
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.runs import checkpoint
from morlax_torch.runs.progress import Progress
from morlax_torch.train import train

CPU = torch.device("cpu")
OWN = """
import torch

def least(tradeoffs, returns):
    return -(-5.0 * tradeoffs * returns).logsumexp(-1)

def bare(tradeoffs, returns):
    return (returns > 0).float().sum(-1)

def broken(tradeoffs, returns):
    return returns @ torch.ones(7)

def full(tradeoffs, returns):
    raise torch.OutOfMemoryError("CUDA out of memory")

def steep(tradeoffs, returns):
    return (returns - returns.detach()).sqrt().sum(-1)
"""
SMALL = {
    "device": "cpu",
    "worlds": 512,
    "horizon": 4,
    "sampling.clusters": 32,
    "ppo.minibatches": 2,
    "ppo.entropy": 0.0,
    "decay_fraction": 0.0,
    "ppo.learning_rate": 1e-3,
    "network.initial_std": 0.1,
}
NARROW = {
    **{key: value for key, value in SMALL.items() if key != "horizon"},
    "worlds": 256,
    "sampling.clusters": 16,
    "network.actor": (32,),
    "network.critic": (32,),
    "network.hidden": (32, 32),
    "network.max_std": 0.2,
    "ppo.learning_rate": 4e-3,
}
FRONTS = {"concave": Concave, "sprint": Sprint, "sphere": Sphere}
BETWEEN = {  # covered shares and IGD+ that tell linear and Chebyshev scalarizations apart
    "concave": (0.75, 0.013),
    "sphere": (0.45, 0.045),
}


@pytest.fixture
def own(tmp_path) -> str:
    """Return the path of a file with utilities."""
    path = tmp_path / "own.py"
    path.write_text(OWN)
    return str(path)


@pytest.fixture
def tasks() -> None:
    for name, task in {**FRONTS, "quadratic": Quadratic}.items():
        envs.register(name, task)


def lagrangian(tradeoffs: torch.Tensor, behind: torch.Tensor, returns: torch.Tensor):
    """Return that of the constraint on objective 1, as far as it depends on the returns."""
    level = tradeoffs[:, 1]
    others = (tradeoffs * -behind / (1 - level)[:, None])[:, [0, 2]].sum(-1)
    multiplier = np.interp(level, np.linspace(0, 1, LEVELS), MULTIPLIERS)
    return others - torch.from_numpy(multiplier) * behind[:, 1]


MULTIPLIERS = np.linspace(0, 3, LEVELS) ** 2
UTILITIES = {  # of trade-offs, distances to the ideal point in units of the range, and returns
    "linear": lambda w, d, r: (w * r).sum(-1),
    "chebyshev": lambda w, d, r: -SMOOTHNESS * (w * d / SMOOTHNESS).exp().sum(-1).log(),
    "augmented-chebyshev": lambda w, d, r: -(w * d).amax(-1) - AUGMENTATION * (w * d).sum(-1),
    "constrained:b": lagrangian,
    "FILE:least": lambda w, d, r: -(-5.0 * w * r).logsumexp(-1),
}


@pytest.mark.parametrize("name", UTILITIES)
def test_weights_are_the_derivatives_of_the_utility(name, own):
    scalarization = make_scalarization(name.replace("FILE", own), "abc", CPU)
    generator = torch.Generator().manual_seed(0)
    returns = 100 * torch.rand(6, 3, generator=generator, dtype=torch.float64)
    tradeoffs = torch.rand(6, 3, generator=generator, dtype=torch.float64)
    tradeoffs /= tradeoffs.sum(1, keepdim=True)
    scalarization.observe(tradeoffs.float(), returns.float())
    if isinstance(scalarization, Constrained):
        scalarization.multipliers.copy_(torch.from_numpy(MULTIPLIERS))
    ideal, nadir = returns.amax(0), returns.amin(0)
    returns.requires_grad_()
    distances = (ideal - returns) / (ideal - nadir)
    utility = UTILITIES[name](tradeoffs, distances, returns)
    (expected,) = torch.autograd.grad(utility.sum(), returns)
    weights = scalarization.weights(tradeoffs, returns.detach())
    assert_allclose(weights, expected, rtol=1e-4, atol=1e-8)


def test_the_range_takes_new_extremes_at_once_and_forgets_old_ones_slowly():
    range_ = SmoothChebyshev(2, CPU)
    steps = torch.tensor([[[0.0, 5.0], [10.0, 1.0]], [[2.0, 9.0], [4.0, 3.0]]])
    range_.observe(steps[0], steps[0])
    assert range_.ideal.tolist() == [10, 5] and range_.nadir.tolist() == [0, 1]
    range_.observe(steps[1], steps[1])
    assert_allclose(range_.ideal, [10 - FORGETTING * 6, 9])
    assert_allclose(range_.nadir, [FORGETTING * 2, 1 + FORGETTING * 2])


@pytest.mark.parametrize(("discount", "length"), [(0.9, 3), (0.99, 100), (1.0, 3)])
def test_expected_returns_are_undiscounted_sums_up_to_the_time_limit(make_agent, discount, length):
    agent, starts, tradeoffs = make_agent(3, 2), torch.randn(2, 5, 3), torch.eye(2)
    value = agent.values(tradeoffs)(agent.observation_normalizer(starts)).mean(1).detach()
    failing = torch.tensor([0.0, 1.0])  # the first policy lasts beyond the limit, the other never
    found = expected_returns(agent, tradeoffs, starts, failing, discount, length)
    for row, steps in ((0, 5000), (1, length)):  # that critics see: with 1 per step, they say
        said = sum(discount**t for t in range(steps if discount < 1 else length))
        assert_allclose(found[row] / value[row] * said, length, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "name"),
    [
        ("concave", "linear"),
        ("concave", "chebyshev"),
        ("concave", "augmented-chebyshev"),
        pytest.param("sphere", "linear", marks=pytest.mark.long),
        pytest.param("sphere", "augmented-chebyshev", marks=pytest.mark.long),
    ],
)
def test_only_chebyshev_covers_a_concave_front(tasks, task, name):
    horizon = max(2, FRONTS[task].episode_length)
    config = config_for(task, scalarization=name, **NARROW, horizon=horizon)
    morlax = MORLAX(envs.make(task, config.worlds, "cpu"), config)
    for _ in range(800 if (task, name) == ("sphere", "augmented-chebyshev") else 150):
        morlax.iterate()
    m = len(morlax.env.objectives)
    tradeoffs, within = evaluation_tradeoffs(33 if m == 2 else 200, m), 0.03 if m == 2 else 0.1
    env = envs.make(task, len(tradeoffs), "cpu", auto_reset=False)
    returns = Evaluator(morlax.agent, env, tradeoffs).evaluate().returns
    front = FRONTS[task].front(1001 if m == 2 else 2500)
    share, far = covered(returns, front, within), pareto.igd_plus(returns, front)
    if name == "linear":
        assert share < BETWEEN[task][0] and far > BETWEEN[task][1]
    else:
        assert share > BETWEEN[task][0] and far < BETWEEN[task][1]


def test_multipliers_follow_their_levels():
    constrained, generator = Constrained(0, 2, CPU), torch.Generator().manual_seed(0)
    levels, expected = np.linspace(0, 1, LEVELS), np.ones(LEVELS)
    for _ in range(20):
        required = torch.rand(50, generator=generator)
        returns = torch.rand(50, 2, generator=generator)
        constrained.observe(torch.stack([required, 1 - required], 1), returns)
        low, high = constrained.nadir[0].item(), constrained.ideal[0].item()
        missing = required.numpy() - (returns[:, 0].numpy() - low) / (high - low)
        near = np.maximum(1 - abs(required.numpy()[:, None] - levels) * (LEVELS - 1), 0)
        expected += RATE * (missing @ near) / np.maximum(near.sum(0), 1e-6)
        expected = np.clip(expected, 0, MOST)
    assert_allclose(constrained.multipliers, expected, atol=1e-4)
    assert expected[-1] > 1 > expected[0] == 0


@pytest.mark.slow
@pytest.mark.long
def test_one_family_meets_every_level_of_a_constraint(tasks):
    config = config_for("quadratic", scalarization="constrained:left", **SMALL)
    morlax = MORLAX(envs.make("quadratic", 512, "cpu"), config)
    for _ in range(400):
        morlax.iterate()
    levels = torch.linspace(0, 1, 11)
    env = envs.make("quadratic", 11, "cpu", auto_reset=False)
    tradeoffs = torch.stack([levels, 1 - levels], 1)
    left, right = Evaluator(morlax.agent, env, tradeoffs).evaluate().returns.T
    assert abs(left - levels.numpy()).max() < 0.15
    away = np.sqrt(1 - left.clip(0, 1))  # from the left place, on the way to the right one
    assert (right > 1 - (1 - away) ** 2 - 0.05).all()


@pytest.mark.parametrize("done", [0, 2])
@pytest.mark.parametrize("name", ["chebyshev", "constrained:left", "FILE:least"])
def test_a_run_resumes_exactly_also_from_its_very_beginning(tasks, name, done, own, tmp_path):
    changes = {**SMALL, "worlds": 64, "sampling.clusters": 8}
    config = config_for("concave", scalarization=name.replace("FILE", own), **changes)
    whole, resumed = (make_learner(envs.make("concave", 64, "cpu"), config) for _ in range(2))
    for _ in range(done):
        whole.iterate()
    path = tmp_path / "latest.pt"
    checkpoint.write(path, checkpoint.snapshot(whole), Progress())
    checkpoint.restore(checkpoint.load(path), path, resumed)
    for learner in (whole, resumed):
        learner.iterate()
    assert "starts" in whole.state_dict()
    assert_same(whole.state_dict(), resumed.state_dict())


@pytest.mark.parametrize("algorithm", ["amor", "hyper-morl", "independent"])
def test_baselines_train_with_chebyshev_utilities(tasks, algorithm):
    changes = {**SMALL, "worlds": 128, "max_env_steps": 128 * 4 * 10}
    config = config_for("concave", algorithm=algorithm, scalarization="chebyshev", **changes)
    learner = make_learner(envs.make("concave", 128, "cpu"), config)
    for _ in range(10):
        learner.iterate()
    assert all(np.isfinite(value) for value in learner.metrics().values())
    assert (learner.scalarization.ideal > learner.scalarization.nadir).all()


MISTAKES = {
    "unknown": ("chebishev", "unknown scalarization 'chebishev': did you mean 'chebyshev'"),
    "an unknown objective": ("constrained:rum", "objective 'rum': did you mean 'run'"),
    "no function": ("FILE:last", "unknown function of .*own.py 'last': did you mean 'least'"),
    "not differentiable": ("FILE:bare", "bare is not differentiable by the returns"),
    "an error": ("FILE:broken", "the utility .*broken fails: RuntimeError"),
    "infinite": ("FILE:steep", "the derivative of the utility .*steep is not finite"),
}


@pytest.mark.parametrize(("name", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_one_sentence(name, message, own, workplace):
    with pytest.raises(MorlaxError, match=message):
        config = config_for(
            "hopper", scalarization=name.replace("FILE", own), device="cpu", worlds=64
        )
        make_scalarization(config.scalarization, ("run", "jump"), CPU)


def test_a_derivative_that_training_finds_not_to_be_finite_is_named(tasks, tmp_path):
    file = tmp_path / "root.py"
    file.write_text("def root(w, r):\n    return (w * (r - 0.9).sqrt()).sum(-1)\n")
    changes = {**SMALL, "worlds": 64, "sampling.clusters": 8, "max_env_steps": 256}
    config = config_for("concave", scalarization=f"{file}:root", **changes)
    with pytest.raises(MorlaxError, match="or a utility whose derivative is finite"):
        train(config, output=tmp_path / "run")


def test_a_lack_of_memory_is_no_mistake_of_the_utility(own):
    with pytest.raises(torch.OutOfMemoryError):
        make_scalarization(f"{own}:full", "ab", CPU)
