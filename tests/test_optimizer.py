"""The flat, clipped Adam is torch's Adam behind torch's gradient clipping."""

import copy

import pytest
import torch

from morlax_torch.gpu.optimizer import ClippedAdam
from morlax_torch.networks.mlp import mlp

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("limit", [0.05, 1e6])
def test_it_equals_torch_s_adam_after_torch_s_clipping(device, limit):
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    torch.manual_seed(0)
    mine = mlp(5, (70, 70), 3).to(device)
    theirs = copy.deepcopy(mine)
    flat = ClippedAdam(mine.parameters(), 1e-2, limit)
    adam = torch.optim.Adam(theirs.parameters(), 1e-2)
    for _ in range(10):
        x = torch.randn(20, 5, device=device)
        flat.step(mine(x).square().mean())
        adam.zero_grad()
        theirs(x).square().mean().backward()
        torch.nn.utils.clip_grad_norm_(theirs.parameters(), limit)
        adam.step()
    for one, other in zip(mine.parameters(), theirs.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)


def test_the_rate_may_change_between_steps():
    parameter = torch.nn.Parameter(torch.zeros(3))
    adam = ClippedAdam([parameter], 0.5, 1e6)
    adam.rate.fill_(0.0)
    adam.step(parameter.sum())
    assert torch.equal(parameter, torch.zeros(3))
    adam.rate.fill_(0.1)
    adam.step(parameter.sum())
    assert (parameter < -0.05).all()


def test_parameters_stay_views_of_the_vector_when_a_state_is_loaded():
    network = mlp(2, (3,), 1)
    adam = ClippedAdam(network.parameters(), 0.1, 1.0)
    network.load_state_dict({name: value + 1 for name, value in network.state_dict().items()})
    assert torch.equal(adam.vector, torch.cat([p.detach().flatten() for p in network.parameters()]))
