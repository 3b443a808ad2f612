"""MO-Gymnasium's wrappers and checks work with the package's environments."""

import gymnasium
import numpy as np
import pytest

mo_gymnasium = pytest.importorskip("mo_gymnasium", reason="MO-Gymnasium is not installed")
wrappers = mo_gymnasium.wrappers
TASK = "morlax_torch/Hopper-v0"
ACTION = np.array([0.3, -0.2, 0.5, 0.1])


def episode(env: gymnasium.Env) -> tuple[list, list[dict]]:
    """Run an episode and return its rewards and infos."""
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


def test_mo_record_episode_statistics_sums_each_objective(env, rewards):
    _, infos = episode(wrappers.MORecordEpisodeStatistics(env, gamma=0.9))
    assert all(reward in env.unwrapped.reward_space for reward in rewards)
    statistics = infos[-1]["episode"]
    assert statistics["l"] == 20
    np.testing.assert_allclose(statistics["r"], rewards.sum(0), rtol=1e-5)
    np.testing.assert_allclose(statistics["dr"], 0.9 ** np.arange(20) @ rewards, rtol=1e-5)
