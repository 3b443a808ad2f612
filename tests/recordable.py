"""Find what a recorded graph cannot hold, without a GPU."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from morlax_torch import MORLAX
from morlax_torch.configuration.config import Config
from morlax_torch.envs.bridges.mjlab.step import MaskedStep
from morlax_torch.evaluation.evaluator import make_evaluator
from morlax_torch.gpu.graph import Graph
from morlax_torch.networks import hypernetwork


class NoSync(TorchDispatchMode):
    """Fails at operations that wait for a GPU, which a recording cannot hold."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = str(func)
        assert not any(part in name for part in ("nonzero", "_local_scalar_dense", "masked_select"))
        if "index" in name and isinstance(args[1], (list, tuple)):
            assert not any(isinstance(x, torch.Tensor) and x.dtype == torch.bool for x in args[1])
        return func(*args, **(kwargs or {}))


class NoCopies(TorchFunctionMode):
    """Fails where numbers become tensors, which a recording cannot copy to a GPU."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        assert func is not torch.tensor
        if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            index = args[1] if isinstance(args[1], tuple) else (args[1],)
            assert not any(isinstance(part, (list, np.ndarray)) for part in index)
        return func(*args, **(kwargs or {}))


def check_recordable(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail unless a graph can hold rollouts, what is learned from them, and evaluations."""
    learner = MORLAX(config.make_worlds(config.worlds, config.seed), config)
    learner.iterate()
    m = len(learner.env.objectives)
    evaluator = make_evaluator(learner.agent, config, "latched", 2 * m, seeds=2, sets=2)
    evaluator._one_step()  # compiles and allocates, as the iteration did
    # while it is recorded, it does not look at numbers either
    monkeypatch.setattr(hypernetwork, "on_simplex", lambda conditions, _: conditions)
    with NoSync(), NoCopies():
        learner._explore()
        learner._learn()
        evaluator._some_steps()


def check_recorded_step(reference: Any, env: Any, steps: int, generator: torch.Generator) -> None:
    """Fail unless our recorded step of `env` follows mjlab's own of `reference`, its twin."""
    step, seen = MaskedStep(env, ("actor",)), torch.zeros_like(reference.obs_buf["actor"])
    action = seen.new_zeros(reference.num_envs, reference.action_manager.total_action_dim)
    graph = Graph(lambda: seen.copy_(step(action)[0]["actor"]), seen.device)
    graph.record()  # takes one step
    reference.step(action)
    for number in range(steps):
        action.copy_(0.2 * torch.randn(action.shape, generator=generator))
        graph()
        groups, *_ = reference.step(action)
        assert torch.equal(reference.episode_length_buf, env.episode_length_buf)
        if number < 5:  # then chaos has made sums of another order visible
            torch.testing.assert_close(groups["actor"], seen, rtol=0.01, atol=0.01)
