"""The kernels that end and begin episodes do what their torch definitions say."""

import pytest
import torch

from morlax_torch import envs
from morlax_torch.envs import Environment, episodes, fused

N = 64


def worlds(seed: int) -> Environment:
    """Humanoids in random states, of which some are not finite."""
    env = envs.make("humanoid", N, "cpu", "warp", seed=seed, reset_noise=0.1)
    generator = torch.Generator().manual_seed(seed)
    for tensor in (env.physics.qpos, env.physics.qvel, env.physics.warmstart, env.physics.sensors):
        tensor.copy_(torch.randn(tensor.shape, generator=generator))
    env.physics.qpos[3, 1], env.physics.qvel[5, -1] = float("nan"), float("inf")
    env.age.copy_(torch.randint(497, 501, (N,), generator=generator))
    return env


def end_fused(physics, failed, *others) -> episodes.Ends:
    ends = episodes.Ends(*(torch.empty_like(failed) for _ in episodes.Ends._fields))
    fused.end(physics, failed, *others, ends)
    return ends


@pytest.mark.parametrize("seed", range(3))
def test_the_kernels_are_their_definitions(seed):
    results = []
    for end, restart in ((episodes.end, episodes.restart), (end_fused, fused.restart)):
        env, generator = worlds(seed), torch.Generator().manual_seed(seed)
        failed = torch.rand(N, generator=generator) < 0.2
        reward = torch.randn(N, 2, generator=generator)
        ends = end(env.physics, failed, 500, env.age, reward, env.blowups)
        assert ends.terminated.any() and ends.truncated.any() and ends.blown_up.sum() == 2
        assert torch.equal(ends.over, ends.terminated | ends.truncated)
        starts = env.starts.draw(env.generator)
        restart(env.physics, ends.over, starts, env.age)
        results.append([*ends, reward, *env.state_dict().values()])
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)
