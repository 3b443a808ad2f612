"""Privileged observations reach only the critics, in step with the observations."""

import pytest
import torch
from tiny import Blind, learner, scaled, tiny
from torch import Tensor

from morlax_torch import Policy, envs, load, save
from morlax_torch.configuration.config import Config
from morlax_torch.exports.exporting import export, manifest
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import Progress

Hopper = envs.get("hopper")
O, P = 6, 7


def blind(env: str = "blind", **changes: object) -> Config:
    return tiny(env, horizon=12, **{"task.reset_noise": 0.01, **changes})


class Sighted(Blind):
    """A hopper whose actor sees everything that Blind's critic sees."""

    def observe(self) -> Tensor:
        return torch.cat([Blind.observe(self), self.physics.qvel.clamp(-10, 10)], -1)

    def privileged(self) -> Tensor | None:
        return None

    layout = Hopper.layout


@pytest.fixture(autouse=True)
def tasks() -> None:
    envs.register("blind", Blind)
    envs.register("sighted", Sighted)


def test_a_step_appends_privileged_numbers_to_the_critic_s_observation(backend):
    blind, sighted = (
        envs.make(name, 8, "cpu", backend, episode_length=7) for name in ("blind", "sighted")
    )
    assert (blind.observation_size, blind.privileged_size) == (O, P)
    assert (sighted.observation_size, sighted.privileged_size) == (O + P, 0)
    assert blind.reset().shape == (8, O)
    sighted.reset()
    for action in torch.rand(20, 8, 4, generator=torch.Generator().manual_seed(0)) * 2 - 1:
        one, other = blind.step(action), sighted.step(action)
        assert torch.equal(one.critic_observation, other.observation)
        assert torch.equal(one.final_critic_observation, other.final_observation)
        assert torch.equal(one.observation, other.observation[:, :O])
        assert torch.equal(one.final_observation, other.final_observation[:, :O])


def test_a_blown_up_world_gives_critics_zeros():
    env = envs.make("blind", 2, "cpu", auto_reset=False)
    env.reset()
    env.physics.qvel[1, 3] = torch.nan
    step = env.step(torch.zeros(2, 4))
    assert (step.final_critic_observation[1] == 0).all()
    assert step.critic_observation.isfinite().all()


def test_a_rollout_stores_the_critics_observations():
    """Sighted is the reference: both tasks move alike under the same actions."""
    morlax = learner(blind(), 1)
    rollout = morlax.rollout
    env = blind("sighted").make_worlds(8, 0)
    observation = env.reset()
    for t in range(12):
        assert torch.equal(rollout.observation[t].flatten(0, 1), observation)
        step = env.step(rollout.action[t].tanh().flatten(0, 1))
        assert torch.equal(rollout.final_observation[t].flatten(0, 1), step.final_observation)
        observation = step.observation
    assert torch.equal(morlax.observation, observation)
    assert rollout.truncated.any()


@scaled()
def test_only_critics_see_privileged_observations(generator):
    agent = learner(blind(), 1).agent
    seen = torch.randn(4, 5, O + P, generator=generator)
    tradeoffs = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7], [0.5, 0.5]])
    policies, values = agent.policies(tradeoffs), agent.values(tradeoffs)
    for column in range(O + P):
        changed = seen.clone()
        changed[..., column] += 1.0
        visible = column < O
        assert torch.equal(policies(changed).output, policies(seen).output) != visible
        assert not torch.allclose(values(changed), values(seen))


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_loaded_and_exported_policies_need_only_observations(tmp_path, generator):
    morlax = learner(blind(), 3)
    checkpoint.write(tmp_path / "whole.pt", checkpoint.snapshot(morlax), Progress())
    save(load(tmp_path / "whole.pt"), tmp_path / "alone.pt")
    observation = torch.randn(5, O, generator=generator)
    expected = Policy(morlax.agent, morlax.config, ("run", "jump"))(observation, (0.2, 0.8))
    for name in ("whole.pt", "alone.pt"):
        found = load(tmp_path / name)
        assert torch.equal(found(observation, (0.2, 0.8)), expected)
        torch.testing.assert_close(found.specialize((0.2, 0.8))(observation), expected)
        assert export(found, tmp_path / "it.ts", "torchscript") < 1e-5
        about = manifest(found)
        assert about["observation_size"] == about["observation"][-1]["slice"][1] == O
    assert evaluate(tmp_path / "whole.pt", tradeoffs=4, device="cpu").returns.shape == (4, 2)
