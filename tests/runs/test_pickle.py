"""Configs and policies can be pickled, for spawned processes, Ray and joblib."""

import copy
import io
import pickle
from pathlib import Path

import pytest
import torch
from programs import SERVER
from tiny import varied

from morlax_torch import MorlaxError, Policy, config_for, envs, load
from morlax_torch.algorithms.registry import LEARNERS
from morlax_torch.configuration.config import Config

WEIGHTS = (0.3, 0.7)
TASK = """
from morlax_torch import envs

class Leaping(envs.get("hopper")):
    class Options(envs.get("hopper").Options):
        leap: float = 2.0
"""
CASES = [("bruce", "morlax"), ("mo-gymnasium/hopper", "morlax")]
CASES += [("cheetah", name) for name in LEARNERS]


@pytest.mark.parametrize(("env", "algorithm"), CASES)
def test_configs_survive_pickling(env, algorithm):
    config = config_for(env, device="cpu", algorithm=algorithm)
    again = pickle.loads(pickle.dumps(config))
    assert again == config == copy.deepcopy(config)
    assert type(again) is type(config)


def saved_and_loaded(policy: Policy) -> Policy:
    whole = io.BytesIO()
    torch.save(policy, whole)
    whole.seek(0)
    return torch.load(whole, weights_only=False)


@pytest.mark.parametrize("copied", (copy.deepcopy, saved_and_loaded))
@pytest.mark.parametrize(
    "changes",
    [
        *({"network.type": kind} for kind in ("dual", "single", "conditioned")),
        {"algorithm": "independent"},
    ],
    ids=str,
)
def test_copies_of_policies_give_the_same_actions(changes, copied):
    policy, observation = varied(**changes), torch.randn(5, 13)
    again = copied(policy)
    assert again.config == policy.config
    for weights in ((1.0, 0.0), WEIGHTS):
        assert torch.equal(again(observation, weights), policy(observation, weights))
        fixed = again.specialize(weights)
        assert torch.equal(fixed(observation), policy.specialize(weights)(observation))


def act(policy: Policy, config: Config, observation: torch.Tensor) -> tuple[list, Config]:
    """Use what another process has pickled."""
    return policy(observation, WEIGHTS).tolist(), config.model_copy(update={"seed": 1})


@pytest.mark.slow
def test_another_process_uses_a_policy_and_a_config(tmp_path):
    (tmp_path / "leaping.py").write_text(TASK)
    config = config_for(f"{tmp_path / 'leaping.py'}:Leaping", device="cpu", **{"task.leap": 3.0})
    policy, observation = load("hopper"), torch.randn(5, 13)
    with SERVER.Pool(1) as pool:
        actions, seeded = pool.apply(act, (policy, config, observation))
    torch.testing.assert_close(torch.tensor(actions), policy(observation, WEIGHTS))
    assert seeded == config.model_copy(update={"seed": 1})
    assert Path(seeded.env.rpartition(":")[0]) == tmp_path / "leaping.py"


@pytest.mark.parametrize("copied", (copy.copy, copy.deepcopy, pickle.dumps))
def test_worlds_are_not_copied(copied, backend):
    env = envs.make("cheetah", 2, "cpu", backend)
    with pytest.raises(MorlaxError, match=r"worlds cannot be copied .* same seed, .*state_dict"):
        copied(env)
    with pytest.raises(MorlaxError, match=r"worlds cannot be copied or pickled"):
        copy.deepcopy({"worlds": env})
