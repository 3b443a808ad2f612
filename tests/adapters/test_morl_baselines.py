"""morl-baselines evaluates the package's policies."""

import gymnasium
import numpy as np
import pytest
import torch

from morlax_torch import MorlaxError
from morlax_torch.adapters.morl_baselines import MorlBaselinesAgent
from morlax_torch.host.resources import one_thread
from morlax_torch.runs.loading import evaluate

TASK = "morlax_torch/Hopper-v0"


def test_the_agent_s_action_equals_the_policy_s(make_policy):
    policy = make_policy("hopper")
    agent, (seen, _) = MorlBaselinesAgent(policy), gymnasium.make(TASK).reset()
    tradeoff = np.array([0.7, 0.3])
    action = agent.eval(seen, tradeoff)
    assert action.shape == (4,) and action.dtype == np.float32
    expected = policy.specialize(tradeoff)(torch.from_numpy(seen)[None])[0]
    np.testing.assert_allclose(action, expected, rtol=1e-5, atol=1e-6)
    with pytest.raises(MorlaxError, match="13 numbers for each"):
        agent.eval(np.zeros(17), tradeoff)
    with pytest.raises(MorlaxError, match="needs 2 numbers"):
        agent.eval(seen, (1.0,))


def test_the_discounted_protocol_gives_what_morl_baselines_measures_in_mo_gymnasium(make_policy):
    evaluation = pytest.importorskip("morl_baselines.common.evaluation", exc_type=ImportError)
    mo_gymnasium = pytest.importorskip("mo_gymnasium")
    changes = {"task": {"reset_noise": 0.0}, "evaluation": {"seeds": 1}}
    policy = make_policy("mo-gymnasium/hopper-2obj", **changes)
    front = evaluate(policy, 4, "discounted", "cpu")
    assert front.reference_point.tolist() == [-100, -100] and front.lengths.max() > 20
    original = mo_gymnasium.make("mo-hopper-2obj-v5", reset_noise_scale=0.0)
    agent = MorlBaselinesAgent(policy, gamma=0.99)
    with one_thread(torch.device("cpu")):
        for tradeoff, returns in zip(front.tradeoffs, front.returns, strict=True):
            *_, discounted = evaluation.eval_mo(agent, original, w=tradeoff)
            np.testing.assert_allclose(returns, discounted, rtol=1e-3)
