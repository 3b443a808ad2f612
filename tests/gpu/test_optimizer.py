"""ClippedAdam equals torch's Adam after torch's gradient clipping."""

import copy

import pytest
import torch

from morlax_torch.gpu.optimizer import ClippedAdam
from morlax_torch.networks.mlp import mlp


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize("limit", [0.05, 1e6])
def test_clipped_adam_equals_torch_s_clipping_and_adam(device, limit):
    network = mlp(5, (70, 70), 3).to(device)
    reference = copy.deepcopy(network)
    flat = ClippedAdam(network.parameters(), 1e-2, limit)
    adam = torch.optim.Adam(reference.parameters(), 1e-2)
    for _ in range(10):
        x = torch.randn(20, 5, device=device)
        flat.step(network(x).square().mean())
        adam.zero_grad()
        reference(x).square().mean().backward()
        torch.nn.utils.clip_grad_norm_(reference.parameters(), limit)
        adam.step()
    for one, other in zip(network.parameters(), reference.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)
