"""Compare traced graphs with the task that they were traced from."""

from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor

from ...envs import Environment
from ...exports.formats import onnxruntime
from .recording import Draws
from .tracing import RESULTS, Graph, Traced, cannot

STEPS = 60
EPISODES = 3
TOLERANCE = 1e-4  # absolute below 1, relative above


class Copy:
    """The traced step, run from copies of the task's state.

    Args:
        traced: the graphs.
    """

    def __init__(self, traced: Traced):
        self.traced, self.values = traced, {}
        self._before, self._after = (_session(g) for g in (traced.before, traced.after))

    def take(self, names: Any = None) -> None:
        """Copy the task's state."""
        for name, values in self.traced.state.items():
            self.values[name] = values.numpy().copy()

    def run(self, graph: Graph, draws: list[Tensor]) -> None:
        """Run one of the two graphs on `values`, and put its outputs there."""
        session = self._before if graph is self.traced.before else self._after
        for name, drawn in zip(graph.draws, draws, strict=True):
            self.values[name] = drawn.numpy()
        given = {name: self.values[name] for name in graph.inputs}
        self.values |= dict(zip(graph.outputs, session.run(None, given), strict=True))


def check(env: Environment, traced: Traced, generator: torch.Generator) -> float:
    """Compare the graphs with `env.step` for some episodes of random actions.

    Returns:
        The largest difference, relative where numbers exceed 1.

    Raises:
        MorlaxError: they differ by more than TOLERANCE.
    """
    copy, largest, simulate = Copy(traced), 0.0, env.physics.step
    for episode in range(EPISODES):
        env.reset()
        for _ in range(STEPS):
            action = _action(env, generator) * min(episode, 1)
            copy.take()
            copy.values["action"] = action.numpy()
            with Draws() as draws:
                largest = max(largest, _one(env, copy, action, draws, simulate))
    return largest


def _one(env: Environment, copy: Copy, action: Tensor, draws: Draws, simulate: Any) -> float:
    found: list[float] = []

    def switch() -> None:
        copy.run(copy.traced.before, draws.values)
        found.append(_difference(env, copy, copy.traced.before))
        draws.values.clear()
        simulate()
        for name in env.physics.arrays:  # type: ignore[attr-defined]
            copy.values[name] = copy.traced.state[name].numpy().copy()

    with torch.no_grad(), patch.object(env.physics, "step", switch):
        step = env.step(action)
    copy.run(copy.traced.after, draws.values)
    results = {name: getattr(step, name).numpy() for name in RESULTS}
    results["terms"] = torch.stack(list(step.terms.values()), -1).numpy()
    for name, exact in results.items():
        found.append(_compared(env, name, exact, copy.values[name]))
    return max(*found, _difference(env, copy, copy.traced.after))


def _difference(env: Environment, copy: Copy, graph: Graph) -> float:
    changed = [name for name in copy.traced.state if name in graph.outputs]
    exact = copy.traced.state
    pairs = [_compared(env, name, exact[name].numpy(), copy.values[name]) for name in changed]
    return max(pairs, default=0.0)


def _compared(env: Environment, name: str, exact: np.ndarray, found: np.ndarray) -> float:
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


def _action(env: Environment, generator: torch.Generator) -> Tensor:
    return 2 * torch.rand(1, env.action_size, generator=generator) - 1


def _session(graph: Graph) -> Any:
    return onnxruntime().InferenceSession(graph.onnx, providers=["CPUExecutionProvider"])
