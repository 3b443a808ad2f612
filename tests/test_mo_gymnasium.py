"""MO-Gymnasium's own wrappers and checks take our environments for its own."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from morlax_torch.adapters.episode_statistics import EpisodeStatistics

mo_gymnasium = pytest.importorskip("mo_gymnasium", reason="MO-Gymnasium is not installed")
wrappers = mo_gymnasium.wrappers
TASK = "morlax_torch/Hopper-v0"
ACTION = np.array([0.3, -0.2, 0.5, 0.1])


def episode(env: gymnasium.Env) -> tuple[list, list[dict]]:
    """Rewards and infos of an episode."""
    env.reset(seed=0)
    rewards, infos, over = [], [], False
    while not over:
        _, reward, terminated, truncated, info = env.step(ACTION)
        rewards.append(np.copy(reward))
        infos.append(info)
        over = terminated or truncated
    return rewards, infos


@pytest.fixture
def env() -> gymnasium.Env:
    return mo_gymnasium.make(TASK, episode_length=20)


@pytest.fixture
def rewards() -> np.ndarray:
    return np.array(episode(mo_gymnasium.make(TASK, episode_length=20))[0])


def test_rewards_lie_in_the_reward_space(env, rewards):
    assert rewards.shape == (20, env.unwrapped.reward_dim)
    assert all(reward in env.unwrapped.reward_space for reward in rewards)


class FreshWeights(gymnasium.Wrapper):
    """Its LinearReward gives the same array away in every step, which Gymnasium 1.4 forbids."""

    def step(self, action):
        *step, info = self.env.step(action)
        return *step, {**info, "reward_weights": info["reward_weights"].copy()}


@pytest.mark.filterwarnings("ignore:.*infinity:UserWarning")
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
def test_scalarised_by_its_wrapper_it_passes_gymnasium_s_check(env):
    linear = wrappers.LinearReward(env, np.array([0.7, 0.3]))
    check_env(FreshWeights(linear), skip_render_check=True, skip_close_check=True)


def test_its_linear_reward_is_our_tradeoff(env):
    theirs, their_infos = episode(wrappers.LinearReward(env, np.array([0.7, 0.3])))
    ours, our_infos = episode(gymnasium.make(TASK, episode_length=20, tradeoff=(0.7, 0.3)))
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    for one, other in zip(our_infos, their_infos, strict=True):
        np.testing.assert_array_equal(one["vector_reward"], other["vector_reward"])


def test_its_statistics_sum_each_objective(env, rewards):
    _, infos = episode(wrappers.MORecordEpisodeStatistics(env, gamma=0.9))
    statistics = infos[-1]["episode"]
    assert statistics["l"] == 20
    np.testing.assert_allclose(statistics["r"], rewards.sum(0), rtol=1e-5)
    np.testing.assert_allclose(statistics["dr"], 0.9 ** np.arange(20) @ rewards, rtol=1e-5)


def test_its_rewards_of_single_objectives_leave_the_others(env, rewards):
    normalised, _ = episode(wrappers.MONormalizeReward(env, idx=0))
    np.testing.assert_array_equal(np.array(normalised)[:, 1], rewards[:, 1])
    assert (np.array(normalised)[1:, 0] != rewards[1:, 0]).all()
    clipped, _ = episode(wrappers.MOClipReward(env, idx=1, min_r=0.0, max_r=1.0))
    np.testing.assert_array_equal(
        np.array(clipped), np.stack([rewards[:, 0], rewards[:, 1].clip(0, 1)], 1)
    )


def test_it_skips_frames(env, rewards):
    skipping = wrappers.MOMaxAndSkipObservation(env, skip=4)
    skipping.reset(seed=0)
    np.testing.assert_allclose(skipping.step(ACTION)[1], rewards[:4].sum(0), rtol=1e-6)


def test_its_vector_environment_runs_them(rewards):
    envs = wrappers.vector.MOSyncVectorEnv(
        [lambda: mo_gymnasium.make(TASK, episode_length=20) for _ in range(2)]
    )
    envs.reset(seed=0)
    for expected in rewards:
        _, reward, _, truncated, _ = envs.step(np.tile(ACTION, (2, 1)))
        np.testing.assert_array_equal(reward, np.tile(expected, (2, 1)))
    assert truncated.all()


def test_our_statistics_have_the_keys_and_the_numbers_of_its_own():
    """In the first episode, that is: after it, its own ones leave out a step of each."""
    pytest.importorskip("array_api_compat")
    from gymnasium.wrappers.vector import ArrayConversion

    def made() -> gymnasium.vector.VectorEnv:
        return gymnasium.make_vec(TASK, num_envs=2, device="cpu", episode_length=20)

    ours = ArrayConversion(EpisodeStatistics(made(), gamma=0.9), torch, np)
    theirs = wrappers.vector.MORecordEpisodeStatistics(ArrayConversion(made(), torch, np), 0.9)
    for env in (ours, theirs):
        env.reset(seed=0)
    for _ in range(20):
        infos = [env.step(np.tile(ACTION, (2, 1)).astype(np.float32))[-1] for env in (ours, theirs)]
    one, other = (info["episode"] for info in infos)
    assert one.keys() == other.keys()
    for name in ("r", "dr", "l"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-5)
