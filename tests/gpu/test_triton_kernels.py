"""Triton kernels against their torch definitions: on a GPU, or interpreted on the CPU."""

import pytest
import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from morlax_torch.algorithms.batch import Batch
from morlax_torch.algorithms.ppo import policy_loss
from morlax_torch.gpu import fused
from morlax_torch.gpu.optimizer import ClippedAdam
from morlax_torch.networks import gaussian
from morlax_torch.networks.gaussian import TanhNormal
from morlax_torch.networks.mlp import mlp

pytest.importorskip("triton", reason="Triton is not installed")

from morlax_torch.gpu import adam_kernels, mlp_kernels, policy_kernels

DEVICE = "cpu" if mlp_kernels.INTERPRETED else "cuda"
TF32_ERROR = 1e-5 if mlp_kernels.INTERPRETED else 2e-3  # TF32 has 10 bits

NETWORKS = [  # sizes, K, S
    ((27, 128, 128, 16), 2, 256 if mlp_kernels.INTERPRETED else 640),
    ((17, 128, 64, 12), 3, 97),
    ((5, 1, 2), 1, 1),
    ((3, 20, 2), 4 if mlp_kernels.INTERPRETED else 64, 17),
    ((9, 64, 33, 256, 7), 2, 40),
]


def draw_family(sizes: tuple[int, ...], K: int) -> tuple[nn.Module, dict[str, Tensor]]:
    """Return an MLP and the parameters of K like it, of unequal scale."""
    target = mlp(sizes[0], sizes[1:-1], sizes[-1]).to(DEVICE)
    named = {
        name: (value + torch.randn(K, *value.shape, device=DEVICE) / value.shape[-1] ** 0.5) / 2
        for name, value in target.named_parameters()
    }
    return target, {name: value.detach().requires_grad_() for name, value in named.items()}


@pytest.mark.parametrize(("sizes", "K", "S"), NETWORKS)
@pytest.mark.slow
def test_mlps_and_their_gradients_equal_vmap_and_repeat(sizes, K, S):
    target, parameters = draw_family(sizes, K)
    table = torch.randn(K, S, sizes[0] + 5, device=DEVICE)
    x = table[..., : sizes[0]]  # columns of a table, as in minibatches
    dy = torch.randn(K, S, sizes[-1], device=DEVICE)

    def run() -> list[Tensor]:
        leaves = list(parameters.values())
        y = mlp_kernels.run(sizes, leaves, x)
        return [y, *torch.autograd.grad(y, leaves, dy)]

    exact = {name: value.detach().double().requires_grad_() for name, value in parameters.items()}
    y = vmap(lambda own, rows: functional_call(target, own, rows))(exact, x.double())
    expected = [y, *torch.autograd.grad(y, list(exact.values()), dy.double())]
    found = run()
    for mine, true in zip(found, expected, strict=True):
        assert (mine.double() - true).norm() < TF32_ERROR * true.norm()
    assert all(torch.equal(*pair) for pair in zip(found, run(), strict=True))

    in_one = torch.cat([leaf.detach().flatten(1) for leaf in parameters.values()], 1)
    y = mlp_kernels.run(sizes, [in_one.requires_grad_()], x)
    (gradient,) = torch.autograd.grad(y, in_one, dy)
    assert torch.equal(y, found[0])
    assert torch.equal(gradient, torch.cat([each.flatten(1) for each in found[1:]], 1))


def test_kernels_are_tried_where_nothing_can_be_differentiated():
    """rsl_rl first runs policies in inference mode."""
    mlp_kernels.fits.cache_clear()
    with torch.inference_mode():
        assert mlp_kernels.fits((3, 16, 2), torch.device(DEVICE))


def test_steps_of_adam_equal_torch(monkeypatch):
    monkeypatch.setattr(fused, "kernels", lambda device: None)
    shapes = [(2, adam_kernels.BLOCK), (100,), (3, 7), (adam_kernels.BLOCK + 1,)]
    parameters = [nn.Parameter(torch.randn(shape, device=DEVICE)) for shape in shapes]
    optimizer = ClippedAdam(parameters, 3e-4, max_norm=1.0)
    vector = optimizer.vector.clone()
    means, squares, steps = torch.zeros_like(vector), torch.zeros_like(vector), vector.new_zeros(())
    state, norms = (means, squares, steps, optimizer.rate), vector.new_zeros(())
    for index in range(8):
        scale = 1e-3 if index % 2 else 1  # some clipped
        gradients = [scale * torch.randn(shape, device=DEVICE) for shape in shapes]
        optimizer.step(sum((p * g).sum() for p, g in zip(parameters, gradients, strict=True)))
        adam_kernels.step(vector, gradients, *state, 1.0, norms)
    torch.testing.assert_close(vector, optimizer.vector, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(means, optimizer.mean, rtol=1e-5, atol=1e-8)
    torch.testing.assert_close(squares, optimizer.square, rtol=1e-5, atol=1e-10)
    torch.testing.assert_close(norms, optimizer.norms)
    assert steps.item() == 8


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
