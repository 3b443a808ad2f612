"""TorchRL trains in the package's worlds."""

import pickle

import gymnasium
import pytest
import torch

from morlax_torch import MorlaxError

pytest.importorskip("torchrl", reason="TorchRL is not installed")

from acting import falling
from tensordict import TensorDict
from torchrl.envs import GymWrapper, RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs

from morlax_torch.adapters.torchrl import TorchRLEnv


def worlds(task: str = "walker", num_envs: int = 4, **options) -> TorchRLEnv:
    return TorchRLEnv(task, num_envs, "cpu", **options)


def falls(tensordict: TensorDict) -> TensorDict:
    return tensordict.set("action", falling())


def still(tensordict: TensorDict) -> TensorDict:
    return tensordict.set("action", torch.zeros(4, 4))


@pytest.mark.parametrize("task", ["walker", "cheetah3"])
def test_an_environment_passes_torchrl_s_checker(task):
    check_env_specs(worlds(task, episode_length=2))


@pytest.mark.parametrize("tradeoff", [None, (0.7, 0.3)])
def test_gym_wrapper_gives_the_same_rollouts_as_the_package_s_environment(tradeoff):
    vector = gymnasium.make_vec(
        "morlax_torch/Walker-v0", num_envs=4, device="cpu", episode_length=100, tradeoff=tradeoff
    )
    found = GymWrapper(vector).rollout(110, falls, break_when_any_done=False)
    expected = worlds(episode_length=100).rollout(110, falls, break_when_any_done=False)
    for key in ("observation", "done", ("next", "terminated"), ("next", "truncated")):
        assert torch.equal(found[key], expected[key]), key
    over = expected["next", "done"][..., 0]
    assert torch.equal(found["next", "observation"][over], expected["next", "observation"][over])
    reward = expected["next", "reward"]
    if tradeoff:
        reward = (reward @ torch.tensor(tradeoff))[..., None]
    torch.testing.assert_close(found["next", "reward"], reward)
    assert over.sum() >= 4


def test_an_unpickled_copy_starts_from_scratch_with_the_same_options():
    env = TransformedEnv(worlds("hopper", reset_noise=0.1, episode_length=7), RewardSum())
    env.set_seed(3)
    first = env.rollout(9, still, break_when_any_done=False)
    copy = pickle.loads(pickle.dumps(env))
    copy.set_seed(3)
    again = copy.rollout(9, still, break_when_any_done=False)
    assert (again == first).all() and first["next", "truncated"].sum() == 4


def test_a_partial_reset_affects_only_the_selected_worlds():
    env = worlds("hopper", reset_noise=0.1)
    env.set_seed(3)
    first = env.reset()
    after = first
    for _ in range(5):
        after = env.rand_step(after)["next"]
    which = torch.tensor([False, True, False, True])[:, None]
    again = env.reset(after.clone().set("_reset", which))
    moved = (again["observation"] != after["observation"]).any(-1)
    assert torch.equal(moved, which[:, 0])
    assert env.worlds.age.tolist() == [5, 0, 5, 0]
    env.set_seed(3)
    assert torch.equal(env.reset()["observation"], first["observation"])


def test_a_mistake_raises_a_clear_error():
    with pytest.raises(MorlaxError, match="call reset first"):
        worlds().rand_step()
    with pytest.raises(MorlaxError, match="use 'cuda' or 'cpu'"):
        worlds().to("meta")
