"""One contract for the adapters to other libraries: all show the package's own worlds."""

from importlib import import_module
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
import torch
from acting import falling
from tiny import Blind
from torch import Tensor

from morlax_torch import MorlaxError, envs

TRADEOFF = (0.7, 0.3)


class Seen(NamedTuple):
    """What a step returns, in tensors; `final` is what ended episodes saw last, or None."""

    observation: Tensor
    reward: Tensor
    objectives: Tensor | None
    terminated: Tensor
    truncated: Tensor
    final: Tensor | None = None


class Adapter:
    """N worlds of a task in another library, with a fixed trade-off and seed."""

    library, home = "", ""  # what it needs, and where the package's class is
    seeded = "seed"  # name of the seed of the models

    def __init__(
        self, task: str = "walker", number: int = 4, tradeoff: Any = TRADEOFF, **options: Any
    ):
        seed = options.pop("seed", 0)
        self.env = self.make(task, tradeoff, number, seed, options)
        self.observation = self.start(seed)

    def make(self, task: str, tradeoff: Any, number: int, seed: int, options: dict) -> Any:
        pytest.importorskip(self.library, reason=f"{self.library} is not installed")
        module, name = self.home.split(":")
        kind = getattr(import_module(f"morlax_torch.adapters.{module}"), name)
        return kind(task, tradeoff, number, "cpu", **{self.seeded: seed}, **options)

    def models(self) -> dict[str, Any]:
        return getattr(self.env, "vector", self.env).worlds.state_dict()


class GymnasiumAdapter(Adapter):
    def make(self, task: str, tradeoff: Any, number: int, seed: int, options: dict) -> Any:
        name = f"morlax_torch/{task.capitalize()}-v0"
        chosen = {"tradeoff": tradeoff, "model_seed": seed, **options}
        return gymnasium.make_vec(name, num_envs=number, device="cpu", **chosen)

    def start(self, seed: int) -> Tensor:
        return self.env.reset(seed=seed)[0]

    def step(self, action: Tensor) -> Seen:
        observation, reward, terminated, truncated, info = self.env.step(action)
        final = info.get("final_obs")
        return Seen(observation, reward, info["vector_reward"], terminated, truncated, final)


class RslRlAdapter(Adapter):
    library, home = "rsl_rl", "rsl_rl:RslRlVecEnv"

    def start(self, seed: int) -> Tensor:
        return self.env.get_observations()["policy"]

    def step(self, action: Tensor) -> Seen:
        observation, reward, done, extras = self.env.step(action)
        truncated, done = extras["time_outs"], done.bool()
        assert ("log" in extras) == done.any()
        objectives = extras["objectives"]
        return Seen(observation["policy"], reward, objectives, done & ~truncated, truncated)

    def privileged(self) -> Tensor | None:
        return self.env.get_observations().get("critic")


class SkrlAdapter(Adapter):
    library, home = "skrl", "skrl:SkrlEnv"

    def start(self, seed: int) -> Tensor:
        return self.env.reset()[0]

    def step(self, action: Tensor) -> Seen:
        observation, *columns, info = self.env.step(action)
        assert torch.equal(self.env.reset()[0], observation)
        reward, terminated, truncated = (column.squeeze(1) for column in columns)
        names = {f"Return / {name}" for name in self.env.vector.objectives}
        logged = info.get("episode", {})  # skrl's trainers log tensors of one number
        assert logged.keys() == (names if (terminated | truncated).any() else set())
        assert all(value.numel() == 1 for value in logged.values())
        return Seen(observation, reward, info["vector_reward"], terminated, truncated)

    def privileged(self) -> Tensor | None:
        return self.env.state()


class StableBaselines3Adapter(Adapter):
    library, home = "stable_baselines3", "stable_baselines3:StableBaselines3VecEnv"
    seeded = "model_seed"

    def start(self, seed: int) -> Tensor:
        self.env.seed(seed)
        return torch.from_numpy(self.env.reset())

    def step(self, action: Tensor) -> Seen:
        observation, reward, done, infos = self.env.step(action.numpy())
        truncated = np.array([info["TimeLimit.truncated"] for info in infos])
        objectives = np.stack([info["vector_reward"] for info in infos])
        final = np.zeros_like(observation)
        for world in done.nonzero()[0]:
            final[world] = infos[world]["terminal_observation"]
        found = observation, reward, objectives, done & ~truncated, truncated, final
        return Seen(*map(torch.from_numpy, found))


class TorchRLAdapter(Adapter):
    def make(self, task: str, tradeoff: Any, number: int, seed: int, options: dict) -> Any:
        pytest.importorskip("torchrl", reason="TorchRL is not installed")
        from morlax_torch.adapters.torchrl import TorchRLEnv

        if tradeoff is not TRADEOFF:
            pytest.skip("TorchRL's environment has all objectives")
        return TorchRLEnv(task, number, "cpu", model_seed=seed, **options)

    def start(self, seed: int) -> Tensor:
        self.env.set_seed(seed)
        self._now = self.env.reset()
        return self._now["observation"]

    def step(self, action: Tensor) -> Seen:
        stepped, self._now = self.env.step_and_maybe_reset(self._now.set("action", action))
        found, objectives = stepped["next"], stepped["next", "reward"]
        flags = (found[name].squeeze(1) for name in ("terminated", "truncated"))
        reward = objectives @ torch.tensor(TRADEOFF)
        return Seen(self._now["observation"], reward, objectives, *flags, found["observation"])


ADAPTERS = [GymnasiumAdapter, RslRlAdapter, SkrlAdapter, StableBaselines3Adapter, TorchRLAdapter]
every = pytest.mark.parametrize("adapter", ADAPTERS, ids=lambda a: a.__name__[: -len("Adapter")])
for_ppo = pytest.mark.parametrize("adapter", [RslRlAdapter, SkrlAdapter])
pytestmark = pytest.mark.usefixtures("single_thread")


@every
def test_a_step_matches_the_package_s_worlds(adapter):
    one, reference = adapter(episode_length=100), envs.make("walker", 4, "cpu", episode_length=100)
    assert torch.equal(one.observation, reference.reset())
    timed_out, fallen = 0, 0
    for _ in range(110):
        seen, step = one.step(falling()), reference.step(falling())
        assert torch.equal(seen.observation, step.observation)
        assert torch.equal(seen.objectives, step.reward)
        np.testing.assert_allclose(seen.reward, step.reward @ torch.tensor(TRADEOFF), rtol=1e-5)
        assert torch.equal(seen.terminated, step.terminated)
        assert torch.equal(seen.truncated, step.truncated)
        over = step.terminated | step.truncated
        if seen.final is not None:
            assert torch.equal(seen.final[over], step.final_observation[over])
        timed_out, fallen = timed_out + step.truncated.sum(), fallen + step.terminated.sum()
    assert timed_out == 1 and fallen >= 3


@for_ppo
def test_actions_are_clipped(adapter):
    once, wildly = adapter("hopper"), adapter("hopper")
    for _ in range(5):
        expected = once.step(torch.ones(4, 4))
        found = wildly.step(torch.full((4, 4), 9.0))
    assert torch.equal(found.observation, expected.observation)


@every
def test_the_seed_determines_initial_states_and_randomized_models(adapter):
    options = {"reset_noise": 0.1, "randomization": {"mass": (0.5, 1.5)}}
    one, same, other = (adapter("hopper", 4, seed=seed, **options) for seed in (3, 3, 4))
    assert torch.equal(one.observation, same.observation)
    assert not torch.equal(one.observation, other.observation)
    masses = [each.models()["model.body_mass"] for each in (one, same, other)]
    assert torch.equal(masses[0], masses[1]) and not torch.equal(masses[0], masses[2])


@for_ppo
def test_critics_see_privileged_observations(adapter):
    envs.register("blind", Blind)
    one = adapter("blind")
    assert one.observation.shape == (4, 6) and one.privileged().shape == (4, 13)
    assert torch.equal(one.privileged()[:, :6], one.observation)
    assert adapter().privileged() is None


def test_a_skrl_environment_that_is_wrapped_twice_is_one_sentence():
    twice = pytest.importorskip("skrl.envs.wrappers.torch").wrap_env(SkrlAdapter().env)
    with pytest.raises(MorlaxError, match="use it without wrap_env"):
        twice.reset()


@every
def test_a_mistake_raises_a_clear_error(adapter):
    with pytest.raises(MorlaxError, match="did you mean 'episode_length'"):
        adapter(episode_lenght=3)
    with pytest.raises(MorlaxError, match=r"actions of shape \(4, 6\)"):
        adapter().step(torch.zeros(4, 7))
    with pytest.raises(MorlaxError, match="needs 2 numbers"):
        adapter("ant", tradeoff=(1.0,))
