"""Trade-offs: random samples for exploration, and fixed sets for evaluation."""

import numpy as np
import pytest
import torch

from morlax_torch.configuration import tradeoffs as points
from morlax_torch.configuration.tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs


def sampled(clusters: int, m: int, *args: object, seed: int = 0) -> torch.Tensor:
    out = torch.empty(clusters, m)
    points.sample_tradeoffs(out, *args, generator=torch.Generator().manual_seed(seed))
    return out


def on_simplex(tradeoffs: torch.Tensor) -> bool:
    sums = tradeoffs.sum(-1)
    return bool((tradeoffs >= 0).all()) and torch.allclose(sums, torch.ones_like(sums))


@pytest.mark.parametrize("m", (2, 3, 6))
def test_the_last_rows_are_the_corners(m):
    for alpha in (0.001, 0.3, 1.0, 50.0):
        tradeoffs = sampled(m + 500, m, m, alpha)
        assert torch.equal(tradeoffs[-m:], torch.eye(m))
        assert on_simplex(tradeoffs)
    assert tradeoffs[:-m].max() < 1
    assert torch.equal(sampled(m, m, m), torch.eye(m))


@pytest.mark.parametrize("m", (2, 4))
@pytest.mark.parametrize("alpha", (0.001, 0.1, 0.7, 1.0, 3.0))
def test_draws_are_distributed_as_those_of_numpy(m, alpha):
    number = 50_000
    found = sampled(number, m, 0, alpha).double().numpy()
    expected = np.random.default_rng(0).dirichlet([alpha] * m, number)
    thresholds = np.array([1e-30, 1e-20, 1e-10, 1e-5, 1e-3, 0.1, 0.5, 0.9, 0.999])
    for values, others in ((found[:, 0], expected[:, 0]), (found.max(1), expected.max(1))):
        below, share = ((x[:, None] < thresholds).mean(0) for x in (values, others))
        error = np.sqrt((share * (1 - share) + 1 / number) * 2 / number)
        assert (np.abs(below - share) < 5 * error).all()


def test_evaluation_tradeoffs_of_two_objectives_are_an_even_grid():
    grid = evaluation_tradeoffs(5, 2)
    expected = [[0, 1], [0.25, 0.75], [0.5, 0.5], [0.75, 0.25], [1, 0]]
    torch.testing.assert_close(grid, torch.tensor(expected))
    assert len(evaluation_tradeoffs(512, 2)) == 512


@pytest.mark.parametrize("m", (3, 6))
def test_evaluation_tradeoffs_of_more_objectives_are_corners_and_fixed_draws(m):
    tradeoffs = evaluation_tradeoffs(200, m)
    assert tradeoffs.shape == (200, m)
    assert on_simplex(tradeoffs)
    for corner in torch.eye(m):
        assert (tradeoffs == corner).all(1).any()
    assert len(tradeoffs.unique(dim=0)) == 200
    torch.manual_seed(99)
    assert torch.equal(evaluation_tradeoffs(200, m), tradeoffs)


def test_dirichlet_tradeoffs_depend_only_on_the_seed():
    draws = dirichlet_tradeoffs(1000, 3)
    assert on_simplex(draws)
    assert torch.equal(dirichlet_tradeoffs(1000, 3), draws)
    assert not torch.equal(dirichlet_tradeoffs(1000, 3, seed=1), draws)
    torch.testing.assert_close(draws.mean(0), torch.full((3,), 1 / 3), rtol=0, atol=0.04)


def test_typical_tradeoffs_are_the_corners_and_the_balanced_one():
    assert points.typical_tradeoffs(2).tolist() == [[1, 0], [0.5, 0.5], [0, 1]]
    three = points.typical_tradeoffs(3)
    assert on_simplex(three) and len(three) == 4
    assert {tuple(row) for row in torch.eye(3).tolist()} < {tuple(row) for row in three.tolist()}


@pytest.mark.parametrize("text", ("0.8,0.2", " .8, 2e-1", "0.80,0.20"))
def test_a_tradeoff_is_parsed_from_text(text):
    assert points.parse_tradeoff(text, ("run", "energy")) == (0.8, 0.2)
    assert points.parse_tradeoff("4,1,0", ("a", "b", "c")) == (4, 1, 0)
