"""The normalizer tracks the mean and variance of all data it was updated with."""

import numpy as np
import pytest
import torch

from morlax_torch.networks.normalizer import Normalizer


def normalizer_of(batches: list[np.ndarray]) -> Normalizer:
    normalizer = Normalizer(batches[0].shape[-1])
    for batch in batches:
        normalizer.update(torch.from_numpy(batch).float())
    return normalizer


@pytest.fixture
def batches() -> list[np.ndarray]:
    """Batches of unequal sizes, shapes and distributions."""
    random = np.random.default_rng(0)
    return [
        random.normal(location, width, (*shape, 3))
        for location, width, shape in (
            (5.0, 1.0, (40,)),
            (-2.0, 3.0, (7, 11)),
            (0.5, 0.1, (1,)),
            (100.0, 20.0, (4, 5, 6)),
        )
    ]


def test_statistics_equal_those_of_the_concatenated_data(batches):
    data = np.concatenate([batch.reshape(-1, 3) for batch in batches])
    normalizer = normalizer_of(batches)
    np.testing.assert_allclose(normalizer.mean, data.mean(0), rtol=1e-5)
    np.testing.assert_allclose(normalizer.variance, data.var(0), rtol=1e-5)
    assert normalizer.count == len(data)


def test_the_weight_scales_a_batch_s_contribution(batches):
    normalizer = normalizer_of(batches[:1])
    old, new = batches[0], batches[1].reshape(-1, 3)
    normalizer.update(torch.from_numpy(new).float(), 0.25)
    share = 0.25 * len(new) / (len(old) + len(new))
    mean = (1 - share) * old.mean(0) + share * new.mean(0)
    square = (1 - share) * (old**2).mean(0) + share * (new**2).mean(0)
    np.testing.assert_allclose(normalizer.mean, mean, rtol=1e-5)
    np.testing.assert_allclose(normalizer.variance, square - mean**2, rtol=1e-4)


def test_normalized_data_has_zero_mean_and_unit_variance(batches):
    x = torch.from_numpy(batches[0]).float()
    assert torch.equal(Normalizer(3)(x.clamp(-9, 9)), x.clamp(-9, 9))  # a new one: the identity
    normalizer = normalizer_of(batches[:1])
    normalized = normalizer(x)
    torch.testing.assert_close(normalized.mean(0), torch.zeros(3), rtol=0, atol=1e-5)
    torch.testing.assert_close(normalized.var(0, correction=0), torch.ones(3))
    torch.testing.assert_close(normalizer.inverse(normalized), x, rtol=1e-5, atol=1e-4)


def test_outliers_are_clipped_to_ten_standard_deviations(batches):
    normalizer = normalizer_of(batches)
    mean, std = normalizer.mean, normalizer.variance.sqrt()
    x = torch.stack([mean + 1000 * std, mean - 1000 * std, mean + 9.9 * std])
    expected = torch.tensor([[10.0], [-10.0], [9.9]]).expand(3, 3)
    torch.testing.assert_close(normalizer(x), expected)


def test_a_constant_column_stays_finite():
    normalizer = normalizer_of([np.full((20, 1), 7.0)])
    assert normalizer(torch.tensor([[7.0], [8.0]])).tolist() == [[0.0], [10.0]]
