"""A conditioned network takes the trade-off as an input."""

import pytest
import torch
from tiny import tiny
from torch import nn
from torch.testing import assert_close

from morlax_torch import MorlaxError, load
from morlax_torch.commands.train import command as train_command
from morlax_torch.networks.family import Conditioned
from morlax_torch.networks.mlp import mlp
from morlax_torch.runs.loading import evaluate
from morlax_torch.train import train

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


def test_a_run_is_trained_resumed_and_evaluated(tmp_path):
    run = train(tiny(**{"network.type": "conditioned"}), output=tmp_path / "run").folder
    train_command(["--resume", str(run), "--max-env-steps", "96"])
    assert evaluate(run, tradeoffs=4, device="cpu").returns.shape == (4, 2)
    policy, seen = load(run), torch.randn(3, 13)
    assert_close(policy.specialize((0.2, 0.8))(seen), policy(seen, (0.2, 0.8)))
