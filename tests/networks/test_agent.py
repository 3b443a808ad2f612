"""The tanh-Gaussian density, and the initial actors and critics for every trade-off."""

import math

import pytest
import torch

from morlax_torch.networks.gaussian import TanhNormal

TRADEOFFS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7], [0.5, 0.5]])


def squashed(mean: torch.Tensor, spread: torch.Tensor) -> TanhNormal:
    return TanhNormal(torch.cat([mean, spread], -1))


@pytest.mark.parametrize("std", (0.05, 0.694, 2.0))
def test_actors_start_with_the_configured_std(std, make_agent):
    policies = make_agent(scale=0.0, initial_std=std).policies(TRADEOFFS)
    found = policies(torch.zeros(4, 1, 3)).std
    torch.testing.assert_close(found, torch.full_like(found, std), rtol=1e-4, atol=0)
    floor = squashed(torch.zeros(3), torch.tensor([-1e3, -20.0, 0.0])).std
    torch.testing.assert_close(floor, torch.tensor([0.001, 0.001, math.log(2) + 0.001]))


def test_a_limit_of_the_std_is_smooth(make_agent, generator):
    observations = torch.randn(4, 50, 3, generator=generator)
    free, limited = (make_agent(initial_std=0.5, max_std=limit) for limit in (None, 0.2))
    before, found = (agent.policies(TRADEOFFS)(observations) for agent in (free, limited))
    torch.testing.assert_close(found.mean, before.mean)
    assert (found.std < 0.2).all()
    assert torch.equal(found.std.flatten().argsort(), before.std.flatten().argsort())
    (slope,) = torch.autograd.grad(found.std.sum(), limited.actor.bias)
    assert slope.abs().sum() > 0  # so that the std can fall again
    exploring = limited.actors(TRADEOFFS).distribution(observations)
    torch.testing.assert_close(exploring.std, found.std)
    small = make_agent(scale=0.0, initial_std=0.01, max_std=0.2).policies(TRADEOFFS)
    std = small(torch.zeros(4, 1, 3)).std  # hardly changed
    torch.testing.assert_close(std, torch.full_like(std, 0.01), rtol=0.05, atol=0)


def test_a_small_output_layer_starts_from_small_actions(make_agent, generator):
    observations = torch.randn(4, 50, 3, generator=generator)
    means = [
        make_agent(scale=0.0, output_scale=scale).policies(TRADEOFFS)(observations).mean
        for scale in (1.0, 0.01)
    ]
    torch.testing.assert_close(0.01 * means[0], means[1])


def test_extreme_values_stay_finite(generator):
    extremes = torch.tensor([-200.0, 0.0, 200.0])
    action, mean, spread = torch.cartesian_prod(*[extremes] * 3).T.unsqueeze(-1)
    mean, spread = mean.clone().requires_grad_(), spread.clone().requires_grad_()
    policy = squashed(mean, spread)
    value = policy.log_prob(action) + policy.entropy(torch.randn(mean.shape, generator=generator))
    value.sum().backward()
    assert all(x.isfinite().all() for x in (value, mean.grad, spread.grad))


def test_initial_networks_are_lecun_uniform_with_zero_biases(make_agent):
    agent = make_agent(30, 4, scale=0.0, actor=(80, 60), critic=(50,))
    for family, sizes in ((agent.actor, (30, 80, 60, 8)), (agent.critic, (30, 50, 2))):
        generated = family.split(family.flat(TRADEOFFS))
        assert len(generated) == 2 * (len(sizes) - 1)
        for layer in range(len(sizes) - 1):
            weight, bias = generated[f"{2 * layer}.weight"][0], generated[f"{2 * layer}.bias"]
            fan_in, fan_out = sizes[layer], sizes[layer + 1]
            bound = math.sqrt(3 / fan_in)  # variance 1 / fan_in
            assert weight.shape == (fan_out, fan_in)
            assert weight.abs().max() <= bound
            assert weight.abs().max() > 0.95 * bound
            assert weight.var().item() == pytest.approx(1 / fan_in, rel=0.25)
            assert bias.abs().max() < 1e-6
    for layer in agent.actor.features[::2]:
        assert layer.weight.abs().max() <= math.sqrt(3 / layer.in_features)
        assert not layer.bias.any()
