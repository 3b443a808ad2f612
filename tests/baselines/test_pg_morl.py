"""The rules of PG-MORL equal slow versions and closed forms; all objectives are maximized."""

from typing import Any

import numpy as np
import pytest
import torch

from morlax_torch import Policy, config_for
from morlax_torch.algorithms.learner import make_agent
from morlax_torch.baselines.pg_morl import learner as pg_morl
from morlax_torch.baselines.pg_morl import population
from morlax_torch.baselines.pg_morl.agent import belongings
from morlax_torch.baselines.pg_morl.learner import PGMORL
from morlax_torch.configuration.config import Config
from morlax_torch.evaluation import pareto
from morlax_torch.exports.exporting import export
from morlax_torch.runs.training import make_evaluator

NAN = float("nan")


def sphere(number: int, m: int, seed: int = 0) -> np.ndarray:
    """Return mutually non-dominated points on the unit sphere, (number, m)."""
    points = np.abs(np.random.default_rng(seed).normal(size=(number, m)))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.sqrt((a @ a) * (b @ b)), -1, 1))))


@pytest.mark.parametrize(("number", "m"), [(1, 3), (9, 2), (50, 3), (20, 6)])
def test_directions_are_unit_vectors_of_the_positive_orthant_that_share_it_evenly(number, m):
    directions = population.directions(number, m)
    assert directions.shape == (number, m)
    assert (directions >= 0).all()
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(number))
    assert (directions == population.directions(number, m)).all()
    shares = np.bincount((sphere(20_000, m, seed=5) @ directions.T).argmax(1)) / 20_000
    assert 0.5 / number < shares.min() <= shares.max() < 1.7 / number


def slow_buffer(
    returns: np.ndarray, reference: np.ndarray, directions: np.ndarray, size: int
) -> list[int]:
    excess = {i: point - reference for i, point in enumerate(returns) if (point > reference).all()}
    most = np.max(list(excess.values()), axis=0)
    bins: list[list[tuple[float, int]]] = [[] for _ in directions]
    for i, vector in excess.items():
        scaled = vector / most
        nearest = min(range(len(directions)), key=lambda k: angle(scaled, directions[k]))
        bins[nearest].append((-float(np.linalg.norm(scaled)), i))
    return [i for content in bins for _, i in sorted(content)[:size]]


@pytest.mark.parametrize(("m", "size"), [(2, 1), (3, 2), (4, 5)])
def test_each_bin_keeps_its_policies_farthest_from_the_reference(m, size):
    random = np.random.default_rng(m)
    returns = random.normal(2, 1, (150, m)) * 10.0 ** np.arange(m)
    reference = 10.0 ** np.arange(m)
    directions = population.directions(12, m)
    kept = population.performance_buffer(returns, reference, directions, size)
    assert kept.tolist() == slow_buffer(returns, reference, directions, size)
    assert 0 < len(kept) <= 12 * size


def test_policies_that_do_not_exceed_the_reference_are_dropped():
    directions = population.directions(4, 2)
    returns = np.array([[1, 0], [0, 1], [-1, 5], [NAN, 1], [np.inf, 1], [1e-9, 1e-9]])
    zero, one = np.zeros(2), np.ones(2)
    assert population.performance_buffer(returns, zero, directions, 3).tolist() == [5]
    assert population.performance_buffer(returns, one, directions, 3).tolist() == []
    assert population.performance_buffer(returns[:0], zero, directions, 3).tolist() == []


def test_candidates_of_two_objectives_are_evenly_spaced_in_angle():
    weights, valid = population.candidate_weights(np.array([[0.5, 0.5], [3, 0], [0, 1]]), 7)
    assert weights.shape == (3, 7, 2)
    assert (weights >= 0).all()
    assert weights.sum(-1) == pytest.approx(np.ones((3, 7)))
    angles = np.degrees(np.arctan2(weights[..., 1], weights[..., 0]))
    assert valid.tolist() == [[True] * 7, [False] * 3 + [True] * 4, [True] * 4 + [False] * 3]
    assert angles[0] == pytest.approx(np.arange(0, 91, 15), abs=1e-5)
    assert angles[1, 3:] == pytest.approx(np.arange(0, 46, 15), abs=1e-5)
    assert angles[2, :4] == pytest.approx(np.arange(45, 91, 15), abs=1e-5)


@pytest.mark.parametrize("m", (3, 4, 7))
def test_candidates_of_more_objectives_lie_within_45_degrees(m):
    random = np.random.default_rng(m)
    current = np.concatenate([np.eye(m), np.full((1, m), 1 / m), random.dirichlet(np.ones(m), 5)])
    weights, valid = population.candidate_weights(current, 8)
    assert weights.shape == (m + 6, 8, m)
    assert valid.all()
    assert (weights > -1e-12).all()
    assert weights.sum(-1) == pytest.approx(np.ones((m + 6, 8)))
    assert weights[:, 0] == pytest.approx(current)
    alone, _ = population.candidate_weights(current, 1)
    assert alone == pytest.approx(current[:, None])
    for center, candidates in zip(current, weights, strict=True):
        assert max(angle(center, candidate) for candidate in candidates) < 45 + 1e-6
        different = [angle(a, b) for i, a in enumerate(candidates[1:]) for b in candidates[i + 2 :]]
        assert min(different) > 5


def hyperbolic(x: np.ndarray, A: float, a: float, b: float, c: float) -> np.ndarray:
    return A * (np.exp(a * (x - b)) - 1) / (np.exp(a * (x - b)) + 1) + c


def history(
    number: int, m: int, noise: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return starts, trade-offs and changes of stretches near returns of 100 in all objectives."""
    random = np.random.default_rng(seed)
    weights = random.dirichlet(np.ones(m), number)
    before = random.uniform(99, 101, (number, m))
    change = np.stack(
        [hyperbolic(weights[:, k], 20 + 5 * k, 6 + k, 0.3, 4 - k) for k in range(m)], -1
    )
    return before, weights, change + random.normal(0, 1, change.shape) * noise


def test_the_model_is_the_one_of_the_paper():
    random = np.random.default_rng(0)
    parameters, x = random.uniform([0, 0.1, -1, -1], [1, 20, 2, 2]), random.random(50)
    assert population.hyperbolic(parameters, x) == pytest.approx(hyperbolic(x, *parameters))


@pytest.mark.parametrize("m", (2, 3, 5))
def test_changes_that_follow_the_model_are_predicted(m):
    before, weights, change = history(60, m)
    candidates = np.random.default_rng(1).dirichlet(np.ones(m), (4, 9))
    points = np.random.default_rng(2).uniform(99, 101, (4, m))
    predicted = population.predict(before, weights, change, points, candidates)
    assert predicted.shape == (4, 9, m)
    for k in range(m):
        expected = hyperbolic(candidates[..., k], 20 + 5 * k, 6 + k, 0.3, 4 - k)
        seen = candidates[..., k] < weights[:, k].max()
        error = predicted[..., k] - points[:, None, k] - expected
        assert np.abs(error[seen]).max() < 0.5


def slow_neighborhood(
    before: np.ndarray, weights: np.ndarray, change: np.ndarray, point: np.ndarray
) -> dict[int, float]:
    """Return the closeness of the stretches in the neighborhood of one policy."""
    ends = np.concatenate([before, before + change])
    away = np.abs(before - point) / (ends.max(0) - ends.min(0))
    reach = 0.1
    while True:
        inside = [i for i, distances in enumerate(away) if (distances <= reach).all()]
        if len({tuple(weights[i]) for i in inside}) >= 4 or len(inside) == len(before):
            break
        reach *= 2
    gaussian = {i: np.exp(-((np.linalg.norm(away[i]) / (0.3 * reach)) ** 2) / 2) for i in inside}
    return {i: value / max(gaussian.values()) for i, value in gaussian.items()}


@pytest.mark.parametrize("kinds", (2, 5, 50))
@pytest.mark.parametrize("m", (2, 3))
def test_neighborhoods_equal_a_slow_search(m, kinds):
    random = np.random.default_rng(kinds)
    before, change = random.normal(0, 5, (60, m)), random.normal(0, 1, (60, m))
    weights = random.dirichlet(np.ones(m), kinds)[random.integers(0, kinds, 60)]
    points = random.normal(0, 4, (10, m))
    extent = np.ptp(np.concatenate([before, before + change]), axis=0)
    _, numbers = np.unique(weights, axis=0, return_inverse=True)
    for point in points:
        expected = slow_neighborhood(before, weights, change, point)
        near = population.neighborhood(np.abs(before - point) / extent, numbers)
        found = dict(zip(near[0].tolist(), near[1], strict=True))
        assert found == pytest.approx(expected)


@pytest.mark.parametrize("m", (2, 3))
def test_without_differences_the_same_change_is_predicted_everywhere(m):
    points = np.full((3, m), 5.0)
    candidates = np.random.default_rng(0).dirichlet(np.ones(m), (3, 4))
    change = np.arange(1.0, m + 1)
    nothing, lost = np.zeros((0, m)), np.full((1, m), NAN)  # what is not finite is ignored
    for before, weights, changes, expected in (
        (nothing, nothing, nothing, 5),
        (lost, candidates[0, :1], lost, 5),
        (points[:1] - 1, candidates[0, :1], change[None], 5 + change),
        (np.full((9, m), 4.0), np.full((9, m), 1 / m), np.tile(change, (9, 1)), 5 + change),
    ):
        predicted = population.predict(before, weights, changes, points, candidates)
        assert predicted == pytest.approx(np.broadcast_to(expected, (3, 4, m)))
    none = population.predict(points, points, points, np.zeros((0, m)), np.zeros((0, 7, m)))
    assert none.shape == (0, 7, m)


def slow_selection(
    archive: np.ndarray, predicted: np.ndarray, number: int, reference: np.ndarray, alpha: float
) -> list[int]:
    """Select by the indicators of the whole archive, all candidates at each step."""
    above = archive[(archive > reference).all(1)]
    scale = (above if len(above) else np.abs(predicted - reference) + reference).max(0) - reference
    virtual, points = (above - reference) / scale, (predicted - reference) / scale
    zero, chosen = np.zeros(len(reference)), []
    for _ in range(number):
        scores = []
        for i, point in enumerate(points):
            union = np.concatenate([virtual, point[None]]) if (point > 0).all() else virtual
            score = pareto.hypervolume(union, zero) - alpha * pareto.sparsity(union)
            scores.append(-np.inf if i in chosen else score)
        chosen.append(int(np.argmax(scores)))
        virtual = np.concatenate([virtual, points[chosen[-1:]]])
    return chosen


@pytest.mark.parametrize("m", (2, 3, 4))
@pytest.mark.parametrize("alpha", (0.0, 0.3, 1.0))
@pytest.mark.parametrize("size", (0, 1, 30))
def test_selection_equals_a_slow_greedy_one(m, alpha, size):
    random = np.random.default_rng(size + m)
    units = 10.0 ** np.arange(m)
    archive = (sphere(size, m) * random.uniform(0.8, 1, (size, 1)) + 0.2) * units
    predicted = (sphere(40, m, seed=1) * random.uniform(0.9, 1.2, (40, 1)) + 0.2) * units
    reference = 0.15 * units
    below = 9 * units
    below[0] = 0.1
    archive = np.vstack([archive, below])
    chosen = population.select(archive, predicted, 6, reference, alpha).tolist()
    assert chosen == slow_selection(archive, predicted, 6, reference, alpha)


@pytest.mark.parametrize("m", (2, 3, 5))
def test_the_sparsity_with_each_point_equals_that_of_the_union(m):
    front, points = sphere(25, m), 1.2 * sphere(20, m, seed=1)
    points = points[population.shortfalls(points, front) < 0]
    expected = [pareto.sparsity([*front, point]) for point in points]
    assert population.sparsities(points, front) == pytest.approx(expected)
    assert population.sparsities(np.full((1, m), 2.0), front).tolist() == [0]
    assert population.sparsities(points, front[:0]).tolist() == [0] * len(points)


def test_the_archive_keeps_what_none_dominates_and_thins_it_evenly():
    random = np.random.default_rng(0)
    returns = np.concatenate([sphere(30, 2), 0.5 * sphere(30, 2, seed=1), [[NAN, 9]]])
    returns = returns[random.permutation(len(returns))] * [1, 1000]
    everything = population.pareto_archive(returns, 100)
    assert everything.tolist() == np.flatnonzero(pareto.non_dominated(returns)).tolist()
    kept = population.pareto_archive(returns, 8)
    assert len(kept) == 8 and set(kept) <= set(everything)
    ends = returns[everything].argmax(0)
    assert set(everything[ends]) <= set(kept)

    def nearest(indices: np.ndarray) -> float:
        points = returns[indices] / np.ptp(returns[everything], axis=0)
        distances = np.linalg.norm(points[:, None] - points, axis=-1)
        return distances[~np.eye(len(points), dtype=bool)].min()

    assert nearest(kept) > 5 * nearest(everything)
    assert population.pareto_archive(np.zeros((0, 2)), 3).tolist() == []
    assert population.pareto_archive(np.array([[NAN, 1.0]]), 3).tolist() == []


TINY: dict[str, Any] = {
    "device": "cpu",
    "algorithm": "pg-morl",
    "worlds": 16,
    "horizon": 20,
    "sampling.clusters": 4,
    "network.actor": (16,),
    "network.critic": (16,),
    "ppo.minibatches": 2,
    "ppo.learning_rate": 3e-3,
    "evaluation.tradeoffs": 12,
    "task.episode_length": 50,
    "max_env_steps": 20_000,
}


@pytest.fixture(autouse=True)
def brief(constants) -> None:
    """Let generations be short."""
    constants("pg-morl", generation=4, warmup=8, bins=10)


def tiny(**changes: Any) -> Config:
    return config_for("cheetah", **{**TINY, **changes})


def made(config: Config, iterations: int = 0) -> PGMORL:
    learner = PGMORL(config.make_worlds(config.worlds, config.seed), config)
    for _ in range(iterations):
        learner.iterate()
    return learner


def simulated_again(learner: PGMORL, number: int) -> np.ndarray:
    """Return what the policies of the archive return in episodes of their own, (number, m)."""
    again = make_agent(learner.env, learner.config, in_order=number)
    for own, archived in zip(belongings(again), belongings(learner.agent), strict=True):
        own.copy_(archived[:number])
    return pg_morl.measuring(again, learner.config, 2).evaluate().returns


@pytest.mark.parametrize("protocol", ["latched", "discounted"])
def test_the_whole_archive_returns_what_was_stored_at_three_times_of_a_run(protocol, monkeypatch):
    monkeypatch.setattr(pg_morl, "intervals", lambda *_: (4, 2))
    learner = made(tiny(**{"evaluation.protocol": protocol}))
    evaluator, sizes = make_evaluator(learner), []
    for _ in range(3):
        for _ in range(4):
            learner.iterate()
        state = learner.state_dict()["population"]
        stored = state["returns"][0].numpy()
        assert simulated_again(learner, len(stored)) == pytest.approx(stored, rel=1e-3)
        front = evaluator.evaluate()
        best = stored[(front.tradeoffs @ stored.T).argmax(1)]
        assert front.returns == pytest.approx(best, rel=1e-3)
        sizes.append(len(stored))
    assert max(sizes) > 3


def test_policies_that_return_to_training_are_what_was_stored():
    learner = made(tiny(), 12)
    start = learner.state_dict()["population"]["returns"][1]
    learner._keep_snapshot(0)
    assert learner._measure()[-4:].numpy() == pytest.approx(start.numpy(), rel=1e-3)
    counts = learner.trained.observation_normalizer.count.flatten()
    assert (counts > 0).all() and (learner.trained.value_normalizer.count > 0).all()
    means = learner.agent.observation_normalizer.mean[: len(learner._archived)]
    assert len(means.unique(dim=0)) > 1


@pytest.mark.parametrize("format", ["onnx", "torchscript"])
@pytest.mark.slow
def test_exported_policies_have_their_own_statistics(format, tmp_path):
    config = tiny()
    learner = made(config, 4)
    size = len(learner._archived)
    means = learner.agent.observation_normalizer.mean[:size]
    with torch.no_grad():  # as different as after a long training
        means += torch.arange(float(size))[:, None, None]
    policy = Policy(learner.agent, config, learner.env.objectives)
    tradeoff = None if format == "onnx" else (0.3, 0.7)
    assert export(policy, tmp_path / "policy", format, tradeoff) < 1e-5
    seen = torch.randn(4, policy.agent.observation_size)
    tradeoffs = torch.tensor([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    each = [policy(x[None], w)[0] for x, w in zip(seen, tradeoffs, strict=True)]
    torch.testing.assert_close(policy(seen, tradeoffs), torch.stack(each))
    for w in tradeoffs:
        torch.testing.assert_close(policy.specialize(w)(seen), policy(seen, w))
