"""Compare traced graphs with the task that they were traced from."""

from collections.abc import Iterable, Mapping
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ...envs import Environment
from ...envs.replacing import replaced
from ...exports.formats import onnxruntime
from ...host.phases import phase
from .recording import Draws
from .tracing import ARRAYS, RESULTS, OnnxGraph, Traced, cannot

STEPS, EPISODES = 60, 3  # of the comparison
TOLERANCE = 1e-4  # of numbers below 1; relative above


class Replica:
    """The traced step, run from copies of the task's state."""

    def __init__(self, traced: Traced):
        self.traced = traced
        self.values: dict[str, np.ndarray] = {}  # of all inputs and outputs, by name
        start = partial(onnxruntime().InferenceSession, providers=["CPUExecutionProvider"])
        self._sessions = {id(graph): start(graph.onnx) for graph in (traced.before, traced.after)}

    def copy(self, names: Iterable[str]) -> None:
        """Copy these tensors of the task."""
        for name in names:
            self.values[name] = self.traced.state[name].numpy().copy()

    def run(self, graph: OnnxGraph, draws: list[Tensor]) -> None:
        """Run one of the two graphs on `values`, with the task's draws, and note its outputs."""
        for name, drawn in zip(graph.draws, draws, strict=True):
            self.values[name] = drawn.numpy()
        given = {name: self.values[name] for name in graph.inputs}
        results = self._sessions[id(graph)].run(None, given)
        self.values |= dict(zip(graph.outputs, results, strict=True))

    def state(self, graph: OnnxGraph) -> dict[str, np.ndarray]:
        own = self.traced.state
        return {name: values.numpy() for name, values in own.items() if name in graph.outputs}


def check(env: Environment, traced: Traced, generator: torch.Generator) -> float:
    """Compare the graphs with `env.step` for some episodes of random actions.

    Returns the largest difference, relative where numbers exceed 1; raises MorlaxError if it is
    more than TOLERANCE.
    """
    replica, largest = Replica(traced), 0.0
    for episode in range(EPISODES):
        env.reset()
        for step in range(STEPS):
            phase("checking the traced task", (episode * STEPS + step) / (EPISODES * STEPS))
            draws = torch.rand(1, env.action_size, generator=generator, dtype=torch.float32)
            random = 2 * draws - 1
            action = random if episode else torch.zeros_like(random)
            largest = max(largest, _step(env, replica, action))
    return largest


def _step(env: Environment, replica: Replica, action: Tensor) -> float:
    """Take one control step twice; returns the largest difference."""
    before, after = replica.traced.before, replica.traced.after
    simulate, gaps = env.physics.step, []
    replica.copy(replica.traced.state)
    replica.values["action"] = action.numpy()

    def switch() -> None:
        replica.run(before, draws.values)
        gaps.append(_largest_gap(env, replica, replica.state(before)))
        draws.values.clear()
        simulate()
        replica.copy(ARRAYS)

    with Draws() as draws, torch.no_grad(), replaced(env.physics, "step", switch):
        step = env.step(action)
    replica.run(after, draws.values)
    results = {name: getattr(step, name).numpy() for name in RESULTS}
    results["terms"] = torch.stack(list(step.terms.values()), -1).numpy()
    return max(*gaps, _largest_gap(env, replica, {**results, **replica.state(after)}))


def _largest_gap(env: Environment, replica: Replica, exact: Mapping[str, np.ndarray]) -> float:
    return max((_gap(env, name, x, replica.values[name]) for name, x in exact.items()), default=0.0)


def _gap(env: Environment, name: str, exact: np.ndarray, found: np.ndarray) -> float:
    exact, found = (x.astype(np.float64).ravel() for x in (exact, found))
    gaps = np.abs(exact - found) / np.maximum(1.0, np.abs(exact))
    gap = float(np.where(np.isnan(exact) & np.isnan(found), 0.0, gaps).max(initial=0.0))
    if not gap <= TOLERANCE:
        raise cannot(
            env,
            f"its traced {name} differs by {gap:.1e}; keep all state in tensors that are changed "
            "in place, and compute with torch only",
        )
    return gap
