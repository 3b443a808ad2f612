"""PPO updates: advantages and targets, minibatches, losses and optimizer steps."""

import copy
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, TanhTransform, TransformedDistribution
from torch.nn.functional import softplus

from morlax_torch.algorithms.batch import Batch, Table, make_batch
from morlax_torch.algorithms.ppo import PPO
from morlax_torch.algorithms.rollout import advantages
from morlax_torch.configuration.sections import PPOConfig
from morlax_torch.gpu.group import Group

TRADEOFFS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7]])


def marked(clusters: int, worlds: int, horizon: int) -> Batch:
    """Make a batch whose numbers encode their column, cluster, world and step."""
    k, g, t = torch.meshgrid(
        *(torch.arange(float(size)) for size in (clusters, worlds, horizon)), indexing="ij"
    )
    code = (10_000 * k + 100 * g + t).unsqueeze(-1)
    widths = Batch(observation=3, action=2, log_prob=1, advantage=1, target=2)
    return Batch(
        *(
            code + 1_000_000 * torch.arange(first, first + width)
            for first, width in zip((0, 3, 5, 6, 7), widths, strict=True)
        )
    )


def codes(part: Batch) -> Tensor:
    """Return the (K, S) codes of a minibatch, after checking that its rows are intact."""
    code = part.observation[..., 0]
    columns = torch.cat(part, -1)
    assert torch.equal(columns, code.unsqueeze(-1) + 1_000_000 * torch.arange(9))
    return code.long()


def drawn(batch: Batch, tradeoffs: Tensor, number: int, epochs: int = 1) -> list[Any]:
    """Return the minibatches of several epochs."""
    generator = torch.Generator().manual_seed(0)
    table = Table(batch)
    return [table.minibatches(tradeoffs, number, generator) for _ in range(epochs)]


def test_an_epoch_uses_every_step_once_in_whole_trajectories():
    K, G, T = 3, 8, 5
    orders = set()
    for parts in drawn(marked(K, G, T), TRADEOFFS, number=4, epochs=3):
        assert len(parts) == 4
        seen = []
        for tradeoffs, part in parts:
            found = codes(part)
            assert torch.equal(tradeoffs, TRADEOFFS)
            assert found.shape == (K, G // 4 * T)  # equal shares of all clusters
            for k in range(K):
                assert (found[k] // 10_000 == k).all()
                worlds, counts = (found[k] // 100).unique(return_counts=True)
                assert len(worlds) == G // 4
                assert (counts == T).all()
            seen.append(found)
        seen = torch.cat(seen, 1)
        assert len(seen.unique()) == seen.numel() == K * G * T
        orders.add(tuple(seen.flatten().tolist()))
    assert len(orders) == 3


def test_dense_minibatches_hold_whole_clusters_with_their_own_tradeoffs():
    N, T = 12, 5
    tradeoffs = torch.stack([torch.arange(N) / N, 1 - torch.arange(N) / N], -1)
    orders = set()
    for parts in drawn(marked(N, 1, T), tradeoffs, number=3, epochs=2):
        assert len(parts) == 3
        seen = []
        for own, part in parts:
            found = codes(part)
            assert found.shape == (N // 3, T)
            clusters = found[:, 0] // 10_000
            assert (found // 10_000 == clusters[:, None]).all()
            assert torch.equal(own, tradeoffs[clusters])
            seen.append(found)
        seen = torch.cat(seen)
        assert len(seen.unique()) == seen.numel() == N * T
        orders.add(tuple(seen.flatten().tolist()))
    assert len(orders) == 2


@pytest.fixture
def learner(make_agent, generator):
    """Make an agent with updated normalizers, so that normalization has an effect."""

    def make(**network):
        agent = make_agent(**network)
        draws = torch.randn(200, 5, generator=generator)
        agent.observation_normalizer.update(2.0 + 1.5 * draws[:, :3])
        agent.value_normalizer.update(torch.tensor([3.0, -5.0]) + 4.0 * draws[:, 3:])
        return agent

    return make


@pytest.mark.parametrize("truncation", ("bootstrap", "mask"))
def test_make_batch_uses_each_cluster_s_own_critic(learner, make_rollout, truncation):
    agent, rollout = learner(), make_rollout()
    config = PPOConfig(discount=0.9, gae_lambda=0.8, truncation=truncation)
    before = copy.deepcopy(agent)

    def value_of(observation: Tensor) -> Tensor:
        seen = before.observation_normalizer(observation)
        critics = [before.critic.specialize(tradeoff) for tradeoff in TRADEOFFS]
        value = torch.stack([critic(seen[:, k]) for k, critic in enumerate(critics)], 1)
        return before.value_normalizer.inverse(value)

    value, final_value = value_of(rollout.observation), value_of(rollout.final_observation)
    vector = advantages(rollout, value, final_value, config)
    target = vector + value
    scalar = torch.einsum("tkgm,km->tkg", vector, TRADEOFFS)
    scalar = (scalar - scalar.mean()) / scalar.std()

    batch, explained = make_batch(agent, TRADEOFFS, rollout, config, TRADEOFFS)

    def by_world(column: Tensor) -> Tensor:  # (T, K, G, ...) -> (K, G, T, ...)
        return column.movedim(0, 2)

    seen = before.observation_normalizer(rollout.observation)
    torch.testing.assert_close(batch.observation, by_world(seen))
    torch.testing.assert_close(batch.action, by_world(rollout.action))
    torch.testing.assert_close(batch.log_prob.squeeze(-1), by_world(rollout.log_prob))
    torch.testing.assert_close(batch.advantage.squeeze(-1), by_world(scalar), rtol=1e-4, atol=1e-4)
    natural = agent.value_normalizer.inverse(batch.target)
    torch.testing.assert_close(natural, by_world(target), rtol=1e-4, atol=1e-4)
    unexplained = (target - value).flatten(0, 2).var(0) / target.flatten(0, 2).var(0)
    torch.testing.assert_close(explained, 1 - unexplained, rtol=1e-4, atol=1e-4)


class Larger(Group):
    """One of two processes; the numbers of the other one are larger by two."""

    size = 2

    def mean_(self, x: Tensor) -> Tensor:
        return x.add_(1.0)


def test_advantages_of_a_cluster_are_normalized_apart_from_other_processes(learner, make_rollout):
    config = PPOConfig(normalize_advantages="cluster")
    batch, _ = make_batch(learner(), TRADEOFFS, make_rollout(), config, TRADEOFFS, Larger())
    std, mean = torch.std_mean(batch.advantage, (1, 2, 3))
    torch.testing.assert_close(mean, torch.zeros(3), rtol=0, atol=1e-5)
    torch.testing.assert_close(std, torch.ones(3), rtol=0, atol=1e-5)


def test_make_batch_updates_only_the_value_normalizer(learner, make_rollout):
    agent, rollout = learner(), make_rollout()
    before = copy.deepcopy(agent)
    stored = [column.clone() for column in rollout]
    batch, _ = make_batch(agent, TRADEOFFS, rollout, PPOConfig(), TRADEOFFS)
    assert all(torch.equal(a, b) for a, b in zip(rollout, stored, strict=True))
    before.value_normalizer.update(agent.value_normalizer.inverse(batch.target))
    for name, value in agent.state_dict().items():
        torch.testing.assert_close(value, before.state_dict()[name], rtol=1e-4, atol=1e-4)
    assert not any(column.requires_grad for column in batch)


@pytest.fixture
def samples(generator) -> Batch:
    """Make samples near the policies' means, so that their densities can be compared."""

    def noise(*shape: int) -> Tensor:
        return torch.randn(3, 20, *shape, generator=generator)

    return Batch(noise(3), noise(2), noise(1), noise(1), noise(2))


def near(batch: Batch, agent) -> Batch:
    """Return the samples with log-probabilities of a slightly different policy."""
    with torch.no_grad():
        log_prob = agent.policies(TRADEOFFS)(batch.observation).log_prob(batch.action)
    return batch._replace(log_prob=log_prob.unsqueeze(-1) + 0.3 * batch.log_prob)


def noise(samples: Batch, generator: torch.Generator) -> Tensor:
    return torch.randn(samples.action.shape, generator=generator)


def losses_of(ppo: PPO, samples: Batch, generator: torch.Generator) -> dict[str, float]:
    """Return the losses and metrics of one minibatch, by name."""
    _, (surrogate, *others) = ppo.policy_loss(TRADEOFFS, samples, noise(samples, generator))
    values = surrogate, ppo.value_loss(TRADEOFFS, samples), *others
    return {name: value.item() for name, value in zip(PPO.metrics, values, strict=True)}


@pytest.mark.parametrize("type", ("dual", "single"))
def test_losses_equal_those_of_specialized_networks(learner, samples, generator, type):
    agent = learner(type=type)
    samples = near(samples, agent)
    config = PPOConfig(clip=0.15)
    policy, value, entropy, kl, clipped = [], [], [], [], []
    for k, tradeoff in enumerate(TRADEOFFS):
        seen, action, old, advantage, target = (column[k] for column in samples)
        mean, spread = agent.actor.specialize(tradeoff)(seen).chunk(2, -1)
        normal = Normal(mean, softplus(spread) + 0.001)
        squashed = TransformedDistribution(normal, TanhTransform(cache_size=1))
        new = squashed.log_prob(squashed.transforms[0](action)).sum(-1)
        ratio = (new - old[:, 0]).exp()
        bounded = ratio.clamp(0.85, 1.15)
        policy.append(-torch.minimum(ratio * advantage[:, 0], bounded * advantage[:, 0]))
        error = agent.critic.specialize(tradeoff)(seen) - target
        value.append(0.5 * (error[:, 0] ** 2 + error[:, 1] ** 2))
        u = normal.sample((2000,))
        log_slope = squashed.transforms[0].log_abs_det_jacobian(u, u.tanh())
        entropy.append((normal.entropy() + log_slope.mean(0)).sum(-1))
        kl.append(ratio - 1 - (new - old[:, 0]))
        clipped.append(((ratio < 0.85) | (ratio > 1.15)).float())
    ppo = PPO(agent, config)
    losses = losses_of(ppo, samples, generator)

    def mean_of(rows: list[Tensor]) -> float:
        return torch.stack(rows).mean().item()

    assert 0.1 < losses["clip_fraction"] < 0.9
    assert losses["policy_loss"] == pytest.approx(mean_of(policy), rel=1e-4)
    assert losses["value_loss"] == pytest.approx(mean_of(value), rel=1e-4)
    assert losses["kl"] == pytest.approx(mean_of(kl), rel=1e-4)
    assert losses["clip_fraction"] == pytest.approx(mean_of(clipped))
    many = [losses_of(ppo, samples, generator)["entropy"] for _ in range(49)]
    error = torch.tensor(many).std().item() / 7
    assert sum(many) / 49 == pytest.approx(mean_of(entropy), abs=5 * error)


def test_the_policy_loss_is_the_surrogate_minus_the_entropy_bonus(learner, samples, generator):
    agent = learner()
    ppo = PPO(agent, PPOConfig(entropy=0.25))
    total, (surrogate, entropy, *_) = ppo.policy_loss(
        TRADEOFFS, near(samples, agent), noise(samples, generator)
    )
    torch.testing.assert_close(total, surrogate - 0.25 * entropy)


def test_a_single_network_takes_adam_steps_on_the_clipped_gradient_of_both_losses(
    learner, samples, monkeypatch
):
    """Of two networks, the example in one file takes the same steps bit for bit."""
    monkeypatch.setattr(PPOConfig, "max_grad_norm", 0.05)
    agent = learner(type="single")
    assert agent.actor.features is agent.critic.features
    samples = near(samples, agent)
    config, oracle = PPOConfig(learning_rate=1e-2, entropy=0.0), copy.deepcopy(agent)
    adam = torch.optim.Adam(oracle.parameters(), 1e-2)
    ppo, generator = PPO(oracle, config), torch.Generator().manual_seed(4)
    for _ in range(3):
        adam.zero_grad()
        policy_loss, _ = ppo.policy_loss(TRADEOFFS, samples, noise(samples, generator))
        (policy_loss + ppo.value_loss(TRADEOFFS, samples)).backward()
        assert torch.nn.utils.clip_grad_norm_(oracle.parameters(), 0.05) > 0.05
        adam.step()
    PPO(agent, config).improve([(TRADEOFFS, samples)] * 3, torch.Generator().manual_seed(4))
    for one, other in zip(agent.parameters(), oracle.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=3e-4)


@pytest.mark.parametrize("type", ("dual", "single"))
@pytest.mark.parametrize("wanted", (1e-4, 1e-2, 1.0))
def test_one_update_per_rollout_adapts_the_rate_to_the_kl_that_it_causes(
    learner, samples, generator, type, wanted
):
    agent = learner(type=type)
    samples = near(samples._replace(log_prob=torch.zeros_like(samples.log_prob)), agent)
    ppo = PPO(agent, PPOConfig(learning_rate=3e-3, desired_kl=wanted))
    acted = agent.policies(TRADEOFFS)(samples.observation).log_prob(samples.action)
    samples = samples._replace(log_prob=acted.detach()[..., None])  # a KL of zero so far
    rate = 3e-3
    for _ in range(5):
        ppo.improve([(TRADEOFFS, samples)], generator)
        kl = losses_of(ppo, samples, generator)["kl"]
        rate *= 1 / 1.5 if kl > 2 * wanted else 1.5 if kl < wanted / 2 else 1.0
        rate = min(rate, 1e-2)
        assert ppo.optimizers[0].rate.item() == pytest.approx(rate)
    assert (rate > 3e-3) == (wanted == 1.0)


def test_every_minibatch_adapts_the_rate_once(learner, samples, generator):
    ppo = PPO(learner(), PPOConfig(learning_rate=1e-6, desired_kl=1.0))
    parts = [(TRADEOFFS, near(samples, ppo.agent))] * 3
    for epoch in range(2):  # of one rollout
        ppo.improve(parts, generator, first=epoch == 0, last=epoch == 1)
    assert ppo.optimizers[0].rate.item() == pytest.approx(1e-6 * 1.5**6)
