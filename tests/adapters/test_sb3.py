"""Stable-Baselines3 trains in the package's worlds."""

import gymnasium
import numpy as np
import pytest

from morlax_torch import MorlaxError

pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")

from acting import falling
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from morlax_torch.adapters.stable_baselines3 import StableBaselines3VecEnv

TRADEOFF = (0.7, 0.3)


def worlds(task: str = "walker", num_envs: int = 4, **options) -> StableBaselines3VecEnv:
    return StableBaselines3VecEnv(task, TRADEOFF, num_envs, "cpu", **options)


def test_the_vector_environment_matches_dummy_vec_env_and_vec_monitor():
    def single() -> gymnasium.Env:
        return gymnasium.make("morlax_torch/Walker-v0", tradeoff=TRADEOFF, episode_length=100)

    found, reference = worlds(episode_length=100), VecMonitor(DummyVecEnv([single] * 4))
    np.testing.assert_array_equal(found.reset(), reference.reset())
    assert found.get_images() == ()
    ended = set()
    for _ in range(110):
        observation, reward, done, infos = found.step(falling().numpy())
        expected, expected_reward, expected_done, expected_infos = reference.step(falling().numpy())
        np.testing.assert_array_equal(observation, expected)
        np.testing.assert_allclose(reward, expected_reward, rtol=1e-6)
        np.testing.assert_array_equal(done, expected_done)
        for found_info, expected_info in zip(infos, expected_infos, strict=True):
            own, other = found_info.pop("episode", None), expected_info.pop("episode", None)
            np.testing.assert_equal(found_info, expected_info)
            over = "terminal_observation" in expected_info
            ended.add((expected_info["TimeLimit.truncated"], over))
            if over:
                assert own["l"] == other["l"]
                assert own["r"] == pytest.approx(other["r"], rel=1e-4)
                assert own["r"] == pytest.approx(np.dot(TRADEOFF, own["returns"]), rel=1e-6)
    assert ended == {(False, False), (False, True), (True, True)}  # falls and one truncation


def test_sb3_s_checker_and_wrappers_work():
    check_env(gymnasium.make("morlax_torch/Hopper-v0", tradeoff=TRADEOFF).unwrapped)
    env = VecNormalize(worlds("cheetah"))
    assert env.reset().shape == (4, 17)
    assert env.get_attr("objectives") == [("run", "energy")] * 4
    assert env.has_attr("reward_space") and not env.has_attr("no_such_thing")
    env.close()


def test_options_of_resets_are_refused_at_once():
    env = VecNormalize(worlds())
    env.set_options({})
    for options in ({"low": 0.1}, [{}, {"low": 0.1}, {}, {}]):
        with pytest.raises(MorlaxError, match="reset takes no options, but got"):
            env.set_options(options)
    assert env.reset().shape == (4, 17)


def test_worlds_are_one_batch():
    with pytest.raises(MorlaxError, match="tradeoff cannot be set"):
        worlds().set_attr("tradeoff", (1, 0))
    with pytest.raises(MorlaxError, match="render cannot be called"):
        worlds().env_method("render")
