"""Learning from a replay: what it samples, and what critics and policies learn from it."""

from types import SimpleNamespace

import pytest
import torch
from closed_form import Quadratic
from test_algorithms import TASK, small, trained
from torch.testing import assert_close

from morlax_torch import MorlaxError, config_for
from morlax_torch.algorithms.off_policy.replay import Replay
from morlax_torch.algorithms.registry import make_learner
from morlax_torch.algorithms.rollout import Rollout
from morlax_torch.runs.training import make_worlds

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
        own.final_observation.copy_(own.observation + 1)
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


def test_a_run_without_its_replay_fills_it_before_it_learns():
    config = small("hyper-sac", 20, **{"method.start": 600})
    learner = trained(config, 3)
    other = make_learner(make_worlds(config, config.worlds), config)
    other._keeps_replay = False  # as on a GPU
    other.load_state_dict(learner.state_dict())
    before = other.agent.actor.bias.detach().clone()
    for changed in (False, False, True):  # an iteration stores 256 transitions
        other.iterate()
        assert torch.equal(other.agent.actor.bias, before) != changed


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method.batch": 100}, r"must be a multiple of sampling.clusters .8.: try --method.batch"),
        ({"scalarization": "chebyshev"}, "hyper-sac needs weighted sums"),
        ({"network.type": "conditioned"}, "hyper-sac needs dual"),
        ({"ppo.critic": "scalar"}, "hyper-sac needs vector"),
    ],
    ids=str,
)
def test_what_cannot_work_is_refused(changes, message):
    with pytest.raises(MorlaxError, match=message):
        small("hyper-sac", **changes)


def test_a_replay_that_does_not_fit_is_refused_and_one_that_does_is_named():
    with pytest.raises(MorlaxError, match=r"a replay of .* takes .* try --method.replay") as error:
        trained(small("hyper-sac", **{"method.replay": 10**12}), 0)
    assert 10**6 < int(str(error.value).rstrip(".").split()[-1]) < 10**12


def test_own_critics_and_worlds_that_hide_endings_are_refused(monkeypatch):
    config = config_for(TASK, device="cpu", algorithm="hyper-sac")
    worlds = make_worlds(config, config.worlds)
    with pytest.raises(MorlaxError, match="makes its own critics"):
        make_learner(worlds, config, critic=torch.nn.Linear(3, 2))
    monkeypatch.setattr(type(worlds), "shows_endings", False)
    with pytest.raises(MorlaxError, match="last observation of each episode"):
        make_learner(worlds, config)
