"""A user's preferred trade-off is found by comparisons."""

import numpy as np
import pytest

from morlax_torch import MorlaxError
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.loading import find_run
from morlax_torch.viewers.explorer.preference import MISTAKES, SHARPNESS, Preference


@pytest.fixture
def line() -> Front:
    """Return four policies on a line, and one that is dominated."""
    returns = np.array([[0.0, 30.0], [1.0, 20.0], [2.0, 10.0], [3.0, 0.0], [0.5, 0.5]])
    weights = np.linspace(0, 1, 5)
    tradeoffs = np.stack([weights, 1 - weights], 1)
    return Front(("run", "save"), tradeoffs, returns, np.full(5, 9), np.zeros(2), np.zeros(5))


def regrets(name: str, users: int) -> list[float]:
    """Return what simulated users lose after 15 answers, as a share of their range of utilities."""
    front, random = Front.load(find_run(name) / "front.npz"), np.random.default_rng(1)
    compared = front.returns[front.non_dominated]
    scaled = (front.returns - compared.min(0)) / np.ptp(compared, axis=0)
    found = []
    for user in range(users):
        utility = scaled @ random.dirichlet(np.ones(scaled.shape[1]))
        preference = Preference(front, seed=user)
        for _ in range(15):
            first, second = preference.pair()
            right = (utility[first] > utility[second]) == (random.random() > 0.1)
            preference.answer(*((first, second) if right else (second, first)))
        possible = utility[preference.policies]
        found.append((possible.max() - utility[preference.best()]) / np.ptp(possible))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "users", "most"),
    [
        pytest.param("cheetah", 20, 0.02, marks=pytest.mark.long),
        pytest.param("cheetah3", 20, 0.02, marks=pytest.mark.long),
        ("bruce", 9, 0.05),
    ],
)
def test_fifteen_answers_find_the_preferred_policy_although_some_are_wrong(name, users, most):
    assert np.median(regrets(name, users)) < most


def test_an_answer_changes_the_weights_as_bayes_rule_says(line):
    preference = Preference(line)
    particles, before = preference._weights.copy(), preference.weights
    preference.answer(3, 0)
    gain = particles @ np.array([1.0, -1.0])
    chance = MISTAKES / 2 + (1 - MISTAKES) / (1 + np.exp(-SHARPNESS * gain))
    np.testing.assert_allclose(preference.weights, chance @ particles / chance.sum())
    assert preference.weights[0] > before[0] + 0.1
    assert preference.best() == 3


def test_dominated_policies_are_not_compared(line):
    preference = Preference(line)
    assert preference.policies.tolist() == [0, 1, 2, 3]
    for _ in range(20):
        first, second = preference.pair()
        assert first != second and {first, second} <= {0, 1, 2, 3}
    with pytest.raises(MorlaxError, match="policy 4 is not one of the front's non-dominated"):
        preference.answer(4, 0)


def test_one_policy_cannot_be_compared(line):
    single = line._replace(returns=np.arange(5)[:, None] * np.ones(2))
    with pytest.raises(MorlaxError, match="there is nothing to compare"):
        Preference(single)
