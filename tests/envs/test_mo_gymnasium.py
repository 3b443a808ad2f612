"""MO-Gymnasium's wrappers work with the package's environments."""

import numpy as np
import pytest

mo_gymnasium = pytest.importorskip("mo_gymnasium", reason="MO-Gymnasium is not installed")


def test_mo_record_episode_statistics_sums_each_objective():
    env = mo_gymnasium.make("morlax_torch/Hopper-v0", episode_length=20)
    env = mo_gymnasium.wrappers.MORecordEpisodeStatistics(env, gamma=0.9)
    env.reset(seed=0)
    steps = [env.step(np.array([0.3, -0.2, 0.5, 0.1])) for _ in range(20)]
    rewards = np.array([reward for _, reward, *_ in steps])
    assert all(reward in env.unwrapped.reward_space for reward in rewards)
    statistics = steps[-1][-1]["episode"]
    assert statistics["l"] == 20
    np.testing.assert_allclose(statistics["r"], rewards.sum(0), rtol=1e-5)
    np.testing.assert_allclose(statistics["dr"], 0.9 ** np.arange(20) @ rewards, rtol=1e-5)
