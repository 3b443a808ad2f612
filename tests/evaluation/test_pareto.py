"""Pareto indicators equal closed forms; all objectives are maximized."""

import moocore
import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError
from morlax_torch.evaluation import pareto
from morlax_torch.evaluation.front import Front

NAN = float("nan")


def test_points_below_the_reference_contribute_nothing():
    assert pareto.hypervolume([[2, 3], [100, -1], [-1, 100]], [0, 0]) == pytest.approx(6)
    assert pareto.hypervolume([[2, 3], [100, 0]], [0, 0]) == pytest.approx(6)
    assert pareto.hypervolume([[100, -1], [-1, 100]], [0, 0]) == 0
    assert pareto.hypervolume(np.zeros((0, 2)), [0, 0]) == 0


def test_duplicates_and_dominated_points_change_nothing():
    steps = np.array([[1.0, 4.0], [2.0, 3.0], [4.0, 1.0]])
    more = np.concatenate([steps, steps, steps - 0.5])
    for indicator in (
        lambda points: pareto.hypervolume(points, [0, 0]),
        pareto.sparsity,
        pareto.cardinality,
        lambda points: pareto.expected_utility(points, np.eye(2)),
        lambda points: pareto.igd_plus(points, [[3, 3], [5, 5]]),
    ):
        assert indicator(more) == pytest.approx(indicator(steps))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16])
def test_tensors_with_gradients_are_points(dtype):
    points = torch.tensor([[1.0, 3.0], [2.0, 2.0]], dtype=dtype, requires_grad=True)
    reference = torch.zeros(2, dtype=dtype, requires_grad=True)
    assert pareto.hypervolume(points, reference) == 5.0
    assert pareto.non_dominated(points).tolist() == [True, True]
    assert points.requires_grad


def test_nan_points_are_dominated():
    points = [[1, 4], [NAN, 9], [9, NAN], [4, 1]]
    assert pareto.non_dominated(points).tolist() == [True, False, False, True]
    assert pareto.hypervolume(points, [0, 0]) == pytest.approx(7)
    assert pareto.expected_utility(points, np.eye(2)) == pytest.approx(4)
    assert pareto.cardinality([[NAN, NAN]]) == 0
    assert pareto.hypervolume([[NAN, NAN]], [0, 0]) == 0


@pytest.mark.parametrize("point", [[0, NAN], [0, -np.inf], [0], [0, 0, 0]])
def test_a_reference_point_is_one_finite_number_per_objective(point):
    with pytest.raises(MorlaxError, match="a reference point of 2 finite numbers is needed, not"):
        pareto.hypervolume([[2, 3]], point)


@pytest.mark.parametrize("points", [[2, 3], [[[2, 3]]], []])
def test_points_are_rows(points):
    for indicator in (pareto.front, pareto.sparsity, pareto.conflicts):
        with pytest.raises(MorlaxError, match=r"points are \(n, m\), one row for each"):
            indicator(points)
    with pytest.raises(MorlaxError, match="one row for each"):
        pareto.hypervolume(points, [0, 0])


def test_trade_offs_and_a_reference_front_fit_the_points():
    points, weights = [[1.0, 2.0], [2.0, 1.0]], [[0.5, 0.5], [1.0, 0.0]]
    with pytest.raises(MorlaxError, match=r"trade-offs are \(n, 2\), .* shape is \(1, 3\)"):
        pareto.expected_utility(points, [[0.2, 0.3, 0.5]])
    with pytest.raises(MorlaxError, match="2 points need as many trade-offs, not 1"):
        pareto.obedience(points, weights[:1])
    with pytest.raises(MorlaxError, match="reference front has numbers that are not finite"):
        pareto.igd_plus(points, [[1.0, np.nan]])


@pytest.mark.parametrize("m", (2, 3, 5))
def test_non_dominated_points_match_pairwise_comparison(m):
    points = np.random.default_rng(m).integers(0, 6, (60, m)).astype(float)
    expected = [
        not any((other >= point).all() and (other > point).any() for other in points)
        and not any((other == point).all() for other in points[:index])
        for index, point in enumerate(points)
    ]
    assert pareto.non_dominated(points).tolist() == expected
    assert pareto.front(points).tolist() == points[expected].tolist()
    assert pareto.cardinality(points) == sum(expected)


def sphere(number: int, m: int) -> np.ndarray:
    """Return mutually non-dominated points on the unit sphere, (number, m)."""
    points = np.abs(np.random.default_rng(0).normal(size=(number, m)))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def named(points: np.ndarray) -> dict[str, float]:
    m = points.shape[1]
    tradeoffs = np.full_like(points, 1 / m)
    lengths, falls = np.full(len(points), 500), np.zeros(len(points))
    return Front(tuple("abcdef"[:m]), tradeoffs, points, lengths, np.zeros(m), falls).indicators()


def test_the_hypervolume_of_many_points_in_five_objectives_is_marked_approximate():
    points = sphere(520, 5)
    exact = moocore.hypervolume(points, ref=np.zeros(5), maximise=True)
    indicators = named(points)
    assert "hypervolume" not in indicators
    assert indicators["hypervolume_approximate"] == pytest.approx(exact, rel=0.01)
    assert indicators["hypervolume_approximate"] == pareto.hypervolume(points, np.zeros(5))
    below = np.concatenate([points, 100 * np.eye(5) - 1])  # points below the reference
    expected = pareto.hypervolume(points, np.full(5, 0.01))
    assert pareto.hypervolume(below, np.full(5, 0.01)) == pytest.approx(expected)


@pytest.mark.parametrize(("number", "m"), ((40, 5), (520, 3), (520, 2)))
def test_the_hypervolume_of_fewer_points_or_objectives_is_exact(number, m):
    points = sphere(number, m)
    exact = moocore.hypervolume(points, ref=np.zeros(m), maximise=True)
    indicators = named(points)
    assert indicators["hypervolume"] == pytest.approx(exact, rel=1e-12)
    others = ["sparsity", "expected_utility", "cardinality", "obedience", "fall_rate"]
    assert list(indicators)[1:] == others  # not hypervolume_approximate


def test_sparsity_is_the_mean_squared_gap():
    # gaps 1, 2 in the first objective and 1, 2 in the second, between three points
    assert pareto.sparsity([[4, 1], [1, 4], [2, 3]]) == pytest.approx((1 + 4 + 1 + 4) / 2)
    # each objective is sorted separately: gaps 1, 1 and 1, 1 and 2, 3
    three = [[1, 2, 5], [2, 3, 2], [3, 1, 0]]
    assert pareto.sparsity(three) == pytest.approx((1 + 1 + 1 + 1 + 4 + 9) / 2)
    assert pareto.sparsity([[1, 1]]) == 0
    assert pareto.sparsity([[1, 1], [0, 0]]) == 0
    assert pareto.sparsity([[NAN, NAN]]) == 0


def test_expected_utility_is_the_mean_utility_of_the_best_points():
    points, tradeoffs = [[4, 0], [0, 6], [1, 1]], [[1, 0], [0, 1], [0.5, 0.5]]
    assert pareto.expected_utility(points, tradeoffs) == pytest.approx((4 + 6 + 3) / 3)
    assert pareto.expected_utility([[NAN, 1]], tradeoffs) == float("-inf")


def test_igd_plus_is_the_mean_distance_to_what_dominates_the_reference():
    points, reference = [[4, 1], [1, 4]], [[4, 5], [2, 0]]  # (4, 5) exceeds (1, 4) by 3 and 1
    assert pareto.igd_plus(points, reference) == pytest.approx((10**0.5 + 0) / 2)
    assert pareto.igd_plus(np.full((3, 2), NAN), reference) == float("inf")


def quarter_circle(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points on a circle, and the trade-off for which each point is optimal."""
    angles = np.linspace(0, np.pi / 2, number)
    points = np.stack([np.cos(angles), np.sin(angles)], -1)
    return points, points / points.sum(1, keepdims=True)


def test_policies_obey_where_they_are_optimal_for_their_own_tradeoffs():
    points, tradeoffs = quarter_circle(41)
    assert pareto.obeys(points, tradeoffs, tolerance=0).all()
    assert pareto.obedience(points, tradeoffs) == 1
    assert pareto.obedience(1000 * points + 7, tradeoffs) == 1  # scale and offset are irrelevant
    points, tradeoffs = quarter_circle(5)
    swapped = points[[1, 0, 2, 4, 3]]
    assert pareto.obeys(swapped, tradeoffs).tolist() == [False, False, True, False, False]
    assert pareto.obedience(swapped, tradeoffs) == pytest.approx(1 / 5)


def test_equal_policies_obey_and_nan_returns_do_not():
    tradeoffs = [[1, 0], [0.5, 0.5], [0, 1]]
    assert pareto.obedience([[3, 4]] * 3, tradeoffs) == 1
    assert pareto.obeys([[3, 4], [NAN, 9], [3, 4]], tradeoffs).tolist() == [True, False, True]
    assert pareto.obedience([[NAN, NAN]] * 3, tradeoffs) == 0


@pytest.mark.parametrize("m", (2, 3, 5))
def test_obedience_matches_its_formula(m):
    random = np.random.default_rng(m)
    tradeoffs = random.dirichlet(np.ones(m), 50)
    points = tradeoffs + random.normal(0, 0.05, (50, m))
    expected = []
    for i, weights in enumerate(tradeoffs):
        utilities = [float(weights @ point) for point in points]
        allowed = 0.1 * (max(utilities) - min(utilities))
        expected.append(max(utilities) - utilities[i] <= allowed)
    assert 0 < sum(expected) < 50
    assert pareto.obeys(points, tradeoffs, 0.1).tolist() == expected


def test_conflicts_are_negated_rank_correlations():
    rising = np.linspace(0.0, 1.0, 9)
    points = np.stack([rising, rising**3, -np.exp(rising), np.ones(9), np.roll(rising, 4)], 1)
    found = pareto.conflicts(points)
    assert found[:3, :3] == pytest.approx(np.array([[-1, -1, 1], [-1, -1, 1], [1, 1, -1]]))
    assert found[3].tolist() == [0] * 5
    ranks = np.arange(9)
    expected = -np.corrcoef(ranks, np.roll(ranks, 4))[0, 1]
    assert found[0, 4] == pytest.approx(expected)
