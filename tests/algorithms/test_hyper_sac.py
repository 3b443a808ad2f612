"""hyper-sac: what its replay samples, and what critics and policies learn from it."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from closed_form import Quadratic
from test_algorithms import TASK, brief, iterate, small, trained  # noqa: F401
from torch.distributions import Normal, TanhTransform, TransformedDistribution
from torch.testing import assert_close

from morlax_torch.algorithms.hyper_sac import HyperSAC, Replay, Transitions
from morlax_torch.algorithms.rollout import Rollout

N, T, DISCOUNT, STEPS = 4, 3, 0.9, 3
SIZES = SimpleNamespace(
    num_worlds=N,
    observation_size=1,
    privileged_size=0,
    action_size=1,
    objectives=("a", "b"),
    device=torch.device("cpu"),
)


def rollouts(number: int, generator: torch.Generator) -> list[Rollout]:
    """Return rollouts of T steps of N worlds in 2 clusters, with episodes that end at random."""
    found = []
    for part in range(number):
        own = Rollout.empty(T, 2, SIZES)
        for name in ("action", "reward"):
            getattr(own, name).normal_(generator=generator)
        time = (part * T + torch.arange(T))[:, None, None].expand(T, 2, N // 2)
        world = torch.arange(N).view(2, N // 2)
        own.observation.copy_((time + 0.1 * world)[..., None])  # names the step and the world
        own.final_observation.copy_(own.observation + 0.5)  # no later step of a rollout shows it
        draws = torch.rand(T, 2, N // 2, generator=generator)
        own.terminated.copy_(draws < 0.15)
        own.truncated.copy_(draws > 0.85)
        found.append(own)
    return found


@pytest.mark.parametrize("number", [1, 4, 11])  # a part of the ring, all of it, and once around
def test_stretches_end_with_their_episodes_and_never_mix_worlds(number, generator):
    capacity = 13
    replay, given = Replay(capacity, SIZES), rollouts(number, generator)
    for rollout in given:
        replay.add(rollout)
    steps = [Rollout(*(x.flatten(1, 2) for x in rollout)) for rollout in given]
    rows = Rollout(*(torch.cat(columns) for columns in zip(*steps, strict=True)))
    first, total = max(0, number * T - capacity), number * T
    seen = set()
    sample = replay.sample(500, STEPS, DISCOUNT, generator)
    for observation, action, reward, following, discount in zip(*sample, strict=True):
        time, world = int(observation), round(10 * (observation.item() % 1))
        assert first <= time < total
        seen.add((time, world))
        wanted, last = torch.zeros(2), time
        for later in range(STEPS):
            last = time + later
            wanted += DISCOUNT**later * rows.reward[last, world]
            ended = rows.terminated[last, world] or rows.truncated[last, world]
            if ended or last == total - 1:
                break
        assert_close(action, rows.action[time, world].tanh())
        assert_close(reward, wanted)
        assert_close(following, rows.final_observation[last, world])
        value = 0.0 if rows.terminated[last, world] else DISCOUNT ** (last - time + 1)
        assert discount.item() == pytest.approx(value)
    assert len(seen) == min(number * T, capacity) * N  # every step of every world


def test_critics_learn_the_values_of_actions():
    """An episode of the task is one step, so the value of an action is its reward."""
    learner = trained(small("hyper-sac", 20, **{"method.learning_rate": 4e-3}), 20)
    action = 0.6 * (2 * torch.rand(200, 2, generator=learner.generator) - 1)
    rewards = Quadratic.returns(action)
    tradeoffs = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    seen = learner.agent.observation_normalizer(torch.ones(3, 200, 1))
    rows = torch.cat([seen, action.expand(3, -1, -1)], -1)
    with torch.no_grad():
        found = learner.agent.critic.run(learner.agent.critic(tradeoffs), rows)
    for twin in found.chunk(2, -1):
        assert (twin * learner._scale() - rewards).abs().mean() < 0.06


def untrained(monkeypatch, **changes: Any) -> HyperSAC:
    """Return a learner of transitions without rewards, half of which are the last of an episode."""
    learner = trained(small("hyper-sac", **changes), 0)

    def sample(number: int, *_: Any) -> Transitions:
        seen, nothing = torch.ones(number, 1), torch.zeros(number, 2)
        action = 2 * torch.rand(number, 2, generator=learner.generator) - 1
        return Transitions(seen, action, nothing, seen, 0.5 * seen)

    monkeypatch.setattr(learner.replay, "sample", sample)
    return learner


@pytest.mark.parametrize("std", [0.05, 0.7])  # an entropy below and above zero
def test_critics_value_the_entropy_of_actions_to_come(std, monkeypatch, constants):
    """Values are (temperature * entropy + value) / 2, which is temperature * entropy."""
    constants("hyper-sac", target_rate=1.0, temperature=0.8)
    faster = {"method.learning_rate": 4e-3, "method.batch": 64}
    learner = untrained(monkeypatch, **{"network.initial_std": std, **faster})
    for optimizer in learner.optimizers[::2]:  # policies and temperature stay
        optimizer.rate.zero_()
    for _ in range(200):
        learner._improve()
    tradeoffs, seen = torch.tensor([[0.3, 0.7]]), torch.ones(1, 1000, 1)
    policy = learner.agent.actors(tradeoffs).distribution(seen)
    squashed = TransformedDistribution(Normal(policy.mean, policy.std), TanhTransform())
    action = squashed.sample()
    entropy = -squashed.log_prob(action).sum(-1).mean()
    with torch.no_grad():
        rows = torch.cat([learner.agent.observation_normalizer(seen), action], -1)
        found = learner.agent.critic.run(learner.agent.critic(tradeoffs), rows)
    assert_close(found.mean(1), (0.8 * entropy).expand(1, 4), rtol=0.15, atol=0)


def test_policies_maximize_weighted_returns_in_the_task_s_units(monkeypatch):
    """Critics predict scaled values, so that the weights of large ones must grow."""
    learner = untrained(monkeypatch)
    learner._squares.copy_(torch.tensor([50.0, 5000.0]) ** 2)  # of returns, which are scaled to 50
    agent, returns = learner.agent, torch.tensor([-3.0, 700.0])  # that all critics predict
    with torch.no_grad():
        agent.critic.weight.zero_()
        parameters = agent.critic.split(agent.critic.bias.zero_())
        for twin in ("0", "1"):
            last = [name for name in parameters if name.startswith(f"networks.{twin}.")][-1]
            parameters[last].copy_(returns / torch.tensor([1.0, 100.0]))
    for optimizer in learner.optimizers:
        optimizer.rate.zero_()
    learner._improve()
    policy_loss, _, entropy, _ = learner._losses
    gain = -policy_loss + learner.log_temperature.exp() * -entropy
    weights, units = learner._drawn, torch.tensor([1.0, 100.0])
    assert_close(gain, ((weights @ returns) / (weights @ units)).mean(), rtol=1e-4, atol=0)


@pytest.mark.parametrize(("wanted", "sign"), [(-10.0, -1), (10.0, 1)])
def test_the_temperature_falls_while_actions_have_more_entropy_than_wanted(
    wanted, sign, monkeypatch
):
    learner = untrained(monkeypatch, **{"method.entropy": wanted})
    before = learner.log_temperature.item()
    for _ in range(3):
        learner._improve()
    assert sign * (learner.log_temperature.item() - before) > 0.005


@pytest.mark.parametrize(
    ("task", "hold", "share"),
    [
        ("cheetah", 0.01, 0),  # a control step
        ("cheetah", 0.04, 0.75),
        (TASK, 1, 0),  # whose control steps have no duration
    ],
)
def test_exploration_holds_its_noise_for_a_time(task, hold, share, generator):
    learner = trained(small("hyper-sac", env=task, **{"method.hold": hold}), 0)
    explore, seen = learner._choose(), learner.rollout.observation[0]
    drawn = torch.randn(50, *learner.rollout.action[0].shape, generator=generator)
    actions = torch.stack([explore(seen, noise)[0] for noise in drawn])
    equal = (actions[1:] == actions[:-1]).all(-1).float()
    assert equal.mean().item() == pytest.approx(share, abs=0.05)
    assert equal[:, 0, 0].std() > 0 or not share  # not all steps of some worlds


@pytest.mark.parametrize("on_gpu", [True, False])
def test_a_run_without_its_replay_fills_it_before_it_learns(constants, on_gpu):
    constants("hyper-sac", start=600)
    config = small("hyper-sac", 20)
    learner = trained(config, 3)
    other = trained(config, 0)
    state, current = learner.state_dict(), other.state_dict()
    if on_gpu:
        del other._process_state["transitions"]
    else:  # the run had another number of processes
        state |= {name: current[name] for name in other.per_process}
    other.load_state_dict(state)
    before = other.agent.actor.bias.detach().clone()
    for changed in (False, False, True):  # an iteration stores 256 transitions
        other.iterate()
        assert torch.equal(other.agent.actor.bias, before) != changed


def test_targets_start_as_networks_that_another_run_replaced(constants):
    constants("hyper-sac", start=10**9)  # nothing is learned
    learner = trained(small("hyper-sac", 10), 0)
    torch.nn.init.normal_(learner.agent.critic.weight)  # as start_from does
    iterate(learner, 1)
    assert torch.equal(learner.target.weight, learner.agent.critic.weight)
