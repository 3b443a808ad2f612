"""A conditioned network takes the trade-off as an input."""

import pytest
import torch
from torch import nn
from torch.testing import assert_close

from morlax_torch import MorlaxError
from morlax_torch.networks.family import Conditioned
from morlax_torch.networks.mlp import mlp

TRADEOFFS = torch.tensor([[0.5, 1.5], [1.0, 0.0], [0.3, 0.7]])
SIMPLEX = torch.tensor([[0.25, 0.75], [1.0, 0.0], [0.3, 0.7]])


@pytest.fixture
def inputs(generator) -> torch.Tensor:
    return torch.randn(3, 5, 4, generator=generator)


@pytest.fixture(params=["mlp", "own"])
def network(request, generator) -> nn.Module:
    if request.param == "mlp":
        return mlp(4 + 2, (8,), 3, generator)
    return nn.Sequential(nn.Linear(4 + 2, 8), nn.LayerNorm(8), nn.Tanh(), nn.Linear(8, 3))


def test_outputs_and_gradients_are_those_of_a_plain_network(network, inputs):
    family = Conditioned(network)
    found = family.run(family(TRADEOFFS), inputs)
    wanted = torch.stack(
        [network(torch.cat([x, w.expand(5, 2)], 1)) for x, w in zip(inputs, SIMPLEX, strict=True)]
    )
    assert_close(found, wanted)
    found.square().sum().backward()
    wanted.square().sum().backward()
    for mine, plain in zip(family.parameters(), network.parameters(), strict=True):
        assert_close(mine.grad, plain.grad)
    with pytest.raises(MorlaxError, match="must not sum to zero"):
        family(torch.zeros(1, 2))


def test_a_specialized_network_is_the_family_s_under_one_tradeoff(network, inputs):
    family = Conditioned(network)
    alone = family.specialize(TRADEOFFS[0])
    wanted = family.run(family(TRADEOFFS), inputs)[0]
    with torch.no_grad():
        next(family.parameters()).zero_()
    assert_close(alone(inputs[0]), wanted)
