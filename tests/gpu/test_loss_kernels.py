"""The losses' Triton kernels equal the torch definitions, in values and gradients."""

import pytest
import torch

from morlax_torch.algorithms.batch import Batch
from morlax_torch.algorithms.ppo import policy_loss
from morlax_torch.networks import gaussian
from morlax_torch.networks.gaussian import TanhNormal

pytest.importorskip("triton", reason="Triton is not installed")

from morlax_torch.gpu import mlp_kernels, policy_kernels

DEVICE = "cpu" if mlp_kernels.INTERPRETED else "cuda"


@pytest.fixture
def samples() -> tuple[torch.Tensor, Batch, torch.Tensor]:
    """The networks' output, a minibatch that is a strided view, and noise."""
    K, S, A = 3, 200, 4
    table = torch.randn(K, S, 5 + A + 1 + 1 + 2)
    batch = Batch(*table.split([5, A, 1, 1, 2], -1))
    output = torch.randn(K, S, 2 * A) * 0.7
    near = TanhNormal(output).log_prob(batch.action) + 0.3 * torch.randn(K, S)
    table[..., 5 + A] = near
    table = table.to(DEVICE)
    batch = Batch(*table.split([5, A, 1, 1, 2], -1))
    return output.to(DEVICE).requires_grad_(), batch, torch.randn(K, S, A).to(DEVICE)


def test_a_fused_action_is_the_sample_and_its_log_probability(samples):
    output, _, noise = samples
    expected, density = gaussian.sample(output.detach().cpu(), noise.cpu())
    action, log_prob = policy_kernels.sample(output.detach(), noise)
    torch.testing.assert_close(action.cpu(), expected)
    torch.testing.assert_close(log_prob.cpu(), density, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("clip", "bonus", "penalty"), [(0.1, 0.0, 0.0), (0.3, 0.02, 0.01)])
def test_the_fused_loss_and_its_gradient_are_those_of_the_definition(samples, clip, bonus, penalty):
    output, batch, noise = samples
    given = (batch.action, noise, batch.log_prob, batch.advantage)
    plain = output.detach().cpu().requires_grad_()
    expected, metrics = policy_loss(
        plain, *(x.cpu() for x in given), clip, penalty, torch.tensor(bonus)
    )
    weight = torch.tensor(bonus).to(output)
    loss, found = policy_kernels.policy_loss(output, *given, clip, penalty, weight)
    torch.testing.assert_close(loss.cpu(), expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found.cpu(), metrics, rtol=1e-4, atol=1e-5)
    (slope,) = torch.autograd.grad(2 * loss, output)
    (exact,) = torch.autograd.grad(2 * expected, plain)
    torch.testing.assert_close(slope.cpu(), exact, rtol=1e-3, atol=1e-6)
