"""The kernels that end and start episodes equal their torch definitions."""

import pytest
import torch

from morlax_torch import envs
from morlax_torch.envs import Environment
from morlax_torch.envs.worlds import episode_kernels, episodes

N = 64


def worlds(seed: int) -> Environment:
    """Humanoids in random states, of which some are not finite."""
    env = envs.make("humanoid", N, "cpu", "warp", seed=seed, reset_noise=0.1)
    generator = torch.Generator().manual_seed(seed)
    for tensor in (env.physics.qpos, env.physics.qvel, env.physics.warmstart, env.physics.sensors):
        tensor.copy_(torch.randn(tensor.shape, generator=generator))
    env.physics.qpos[3, 1], env.physics.qvel[5, -1] = float("nan"), float("inf")
    env.physics.qpos[13, 0], env.physics.qvel[15, 2] = -1e9, 1e9
    env.age.copy_(torch.randint(497, 501, (N,), generator=generator))
    return env


@pytest.mark.parametrize("seed", range(3))
def test_the_kernels_are_their_definitions(seed):
    results = []
    for module in (episodes, episode_kernels):
        env, generator = worlds(seed), torch.Generator().manual_seed(seed)
        failed = torch.rand(N, generator=generator) < 0.2
        reward = torch.randn(N, 2, generator=generator)
        terms = torch.randn(N, 3, generator=generator)
        action = torch.randn(N, 17, generator=generator)
        observation = torch.randn(N, 9, generator=generator)
        action[7, 2], observation[9, 8], reward[11, 1] = float("nan"), float("inf"), float("nan")
        reached = failed, 500, env.age
        ends = module.end(env.physics, action, observation, *reached, reward, terms, env.blowups)
        assert ends.terminated.any() and ends.truncated.any()
        assert ends.blown_up.nonzero().flatten().tolist() == [3, 5, 7, 9, 11, 13, 15]
        assert (reward[ends.blown_up] == 0).all() and (terms[ends.blown_up] == 0).all()
        assert torch.equal(ends.over, ends.terminated | ends.truncated)
        starts = env.starts.draw(env.draws)
        module.restart(env.physics, ends.over, starts, env.age)
        results.append([*ends, reward, terms, *env.state_dict().values()])
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)
