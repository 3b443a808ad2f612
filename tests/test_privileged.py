"""What is privileged reaches critics, at the right moment, and nothing else."""

import pytest
import torch
from torch import Tensor

from morlax_torch import MORLAX, Policy, envs, export, load, save
from morlax_torch.config import Config, load_config, merged
from morlax_torch.envs.worlds.layout import positions
from morlax_torch.evaluate import evaluate
from morlax_torch.exports.manifest import manifest
from morlax_torch.runs import checkpoint
from morlax_torch.runs.training import make_worlds

Hopper = envs.get("hopper")
O, P = 6, 7
TINY = {
    "env": "blind",
    "device": "cpu",
    "worlds": 32,
    "horizon": 12,
    "sampling": {"clusters": 4},
    "ppo": {"minibatches": 2, "epochs": 2},
    "task": {"episode_length": 9, "reset_noise": 0.01},
}


class Blind(Hopper):
    """A hopper that acts by positions alone; its critic knows velocities too."""

    def observe(self) -> Tensor:
        return self.physics.qpos[:, 1:]

    def privileged(self) -> Tensor | None:
        return self.physics.qvel.clamp(-10, 10)

    def layout(self) -> list[envs.Part]:
        return positions(self.physics.model)[1:]


class Sighted(Blind):
    """What the blind one's critic sees, for the actor too."""

    def observe(self) -> Tensor:
        return torch.cat([Blind.observe(self), self.physics.qvel.clamp(-10, 10)], -1)

    def privileged(self) -> Tensor | None:
        return None

    layout = Hopper.layout


@pytest.fixture(autouse=True)
def tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(envs.registry, "_REGISTRY", dict(envs.registry._REGISTRY))
    envs.register("blind", Blind)
    envs.register("sighted", Sighted)


def tiny(**changes: object) -> Config:
    return load_config(merged(TINY, changes))


def trainer(config: Config, iterations: int) -> MORLAX:
    morlax = MORLAX(make_worlds(config, config.worlds), config)
    for _ in range(iterations):
        morlax.iterate()
    return morlax


@pytest.mark.parametrize("backend", ("mujoco", "warp"))
def test_a_step_shows_critics_more_than_policies(backend):
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


def test_where_nothing_is_privileged_nothing_is_copied():
    env = envs.make("hopper", 4, "cpu")
    env.reset()
    step = env.step(torch.zeros(4, 4))
    assert step.observation.data_ptr() == step.critic_observation.data_ptr()
    assert step.observation.shape == step.critic_observation.shape
    assert step.final_observation.data_ptr() == step.final_critic_observation.data_ptr()


def test_a_blown_up_world_shows_critics_zeros():
    env = envs.make("blind", 2, "cpu", auto_reset=False)
    env.reset()
    env.physics.qvel[1, 3] = torch.nan
    step = env.step(torch.zeros(2, 4))
    assert (step.final_critic_observation[1] == 0).all()
    assert step.critic_observation.isfinite().all()


def test_a_rollout_keeps_what_critics_saw():
    """Both tasks' worlds move alike under the same actions, so one is the other's reference."""
    morlax = trainer(tiny(), 1)
    rollout = morlax.rollout
    env = make_worlds(tiny(env="sighted"), 32)
    observation = env.reset()
    for t in range(12):
        assert torch.equal(rollout.observation[t].flatten(0, 1), observation)
        step = env.step(rollout.action[t].tanh().flatten(0, 1))
        assert torch.equal(rollout.final_observation[t].flatten(0, 1), step.final_observation)
        observation = step.observation
    assert torch.equal(morlax.observation, observation)
    assert rollout.truncated.any()


def test_actors_do_not_see_what_is_privileged_and_critics_do(generator):
    agent = trainer(tiny(network={"scale": 0.3}), 1).agent
    seen = torch.randn(4, 5, O + P, generator=generator)
    tradeoffs = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.3, 0.7], [0.5, 0.5]])
    policies, values = agent.policies(tradeoffs), agent.values(tradeoffs)
    for column in range(O + P):
        changed = seen.clone()
        changed[..., column] += 1.0
        visible = column < O
        assert torch.equal(policies(changed).output, policies(seen).output) != visible
        assert not torch.allclose(values(changed), values(seen))


def test_both_are_normalised(generator):
    normalizer = trainer(tiny(), 3).agent.observation_normalizer
    assert normalizer.mean.shape == (O + P,)
    assert (normalizer.variance != 1).all()
    seen = torch.randn(5, O + P, generator=generator)
    assert torch.equal(normalizer(seen)[:, :O], normalizer(seen[:, :O]))


@pytest.mark.filterwarnings("ignore:.*treespec:FutureWarning")
def test_what_is_loaded_or_exported_needs_only_observations(tmp_path, generator):
    morlax = trainer(tiny(), 3)
    checkpoint.save(tmp_path / "whole.pt", morlax, {})
    save(load(tmp_path / "whole.pt"), tmp_path / "alone.pt")
    observation = torch.randn(5, O, generator=generator)
    expected = Policy(morlax.agent, morlax.config, ("run", "jump"))(observation, (0.2, 0.8))
    for name in ("whole.pt", "alone.pt"):
        found = load(tmp_path / name)
        assert torch.equal(found(observation, (0.2, 0.8)), expected)
        torch.testing.assert_close(found.specialize((0.2, 0.8))(observation), expected)
        assert export.export(found, tmp_path / "it.pt2", "torch-export") < 1e-5
        about = manifest(found)
        assert about["observation_size"] == about["observation"][-1]["slice"][1] == O
    assert evaluate(tmp_path / "whole.pt", tradeoffs=4, device="cpu").returns.shape == (4, 2)
