"""Trace a task's control step into two graphs, before the physics and after it, and check them."""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np
import torch
from torch import Tensor

from ...envs import Environment, MorlaxError
from ...envs.errors import LONGEST
from ...envs.physics.mujoco import MujocoPhysics
from ...exports.exporting import onnx_model, onnxruntime, quiet
from ...host.phases import phase
from .recording import Draws, Recorder, Writes, flat, storage

ARRAYS = {  # of `Physics`, and their names in mjData
    "qpos": "qpos",
    "qvel": "qvel",
    "act": "act",
    "ctrl": "ctrl",
    "warmstart": "qacc_warmstart",
    "sensors": "sensordata",
}
RESULTS = ("observation", "reward", "terminated", "truncated")  # of a `TimeStep`
STEPS, EPISODES = 60, 3  # of the check
TOLERANCE = 1e-4  # of numbers below 1; relative above


class PagePhysics(MujocoPhysics):
    """One world whose tensors are float32, as in training, while MuJoCo computes in float64.

    Browsers run every operation in float32, but not all of them in float64.
    """

    def __init__(self, model: mujoco.MjModel, substeps: int):
        super().__init__(model, 1, substeps)
        self._exact = {name: getattr(self, name).numpy() for name in ARRAYS if name != "sensors"}
        for name, values in self.arrays.items():
            setattr(self, name, values.to(torch.float32))

    @property
    def arrays(self) -> dict[str, Tensor]:
        """All tensors (1, ...), by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def step(self) -> None:
        # by NumPy, because a recorder must not see it
        for name, exact in self._exact.items():
            exact[:] = getattr(self, name).numpy()
        super().step()
        for name, exact in self._exact.items():
            getattr(self, name).numpy()[:] = exact


class OnnxGraph(NamedTuple):
    """An ONNX model, and the order of its inputs and outputs."""

    onnx: bytes
    inputs: dict[str, Tensor]  # by name, with example values
    outputs: tuple[str, ...]
    draws: dict[str, Any]  # the inputs that are random: name -> `Draw`


class Traced(NamedTuple):
    """A control step as graphs; both read and change the state by name.

    `before` maps an action to the control of the motors, `after` maps the state after the physics
    to observation, rewards and the end of the episode.
    """

    before: OnnxGraph
    after: OnnxGraph
    state: dict[str, Tensor]  # (size,) physics and task state: views of the environment's
    terms: tuple[str, ...]  # names of the reward terms


def trace(env: Environment) -> Traced:
    """Trace `env.step`; raises MorlaxError if no graph can express the task."""
    try:
        return _traced(env)
    except MorlaxError as error:
        raise cannot(type(env), str(error)) from None


def cannot(task: type[Environment], reason: str) -> MorlaxError:
    reason = " ".join(reason.split()).rstrip(".")
    return MorlaxError(f"{task.__name__} cannot run in a browser: {reason}.")


def persisting(env: Environment, action: Tensor) -> dict[str, Tensor]:
    """Return the storages (size,) that steps and resets change, by name; physics first."""
    physics = env.physics
    assert isinstance(physics, PagePhysics)
    state = {name: flat(values) for name, values in physics.arrays.items()}
    if env.command_limits:
        state["command"] = flat(env.command)
    named = {storage(values) for values in state.values()}
    for act in (lambda: env.step(action), env.reset):
        with Writes() as writes, torch.no_grad():
            act()
        for memory, values in writes.storages.items():
            if memory not in named:
                named.add(memory)
                state[f"state_{len(state)}"] = values
    return state


def _traced(env: Environment) -> Traced:
    action = torch.zeros(1, env.action_size, dtype=torch.float32)
    state = persisting(env, action)
    env.reset()
    before = Recorder(state)
    before.input("action", action)
    after = Recorder(state, before)
    simulate = env.physics.step

    def switch() -> None:
        recording.close()
        simulate()
        recording.enter_context(after)

    with ExitStack() as recording, torch.no_grad(), patch.object(env.physics, "step", switch):
        recording.enter_context(before)
        step = env.step(action)
        terms = torch.stack(list(step.terms.values()), -1)
    for name in RESULTS:
        after.output(name, getattr(step, name))
    after.output("terms", terms)
    for name, tensor in after.carried.items():
        before.output(name, tensor)
    return Traced(_graph(before), _graph(after), state, tuple(step.terms))


def _graph(recorder: Recorder) -> OnnxGraph:
    module = recorder.module()
    inputs, outputs = recorder.inputs, tuple(recorder.outputs)
    with quiet(), torch.no_grad():
        try:
            program = torch.export.export(module, tuple(inputs.values())).run_decompositions({})
            results = [f"next_{name}" for name in outputs]  # ONNX needs names of their own
            model = onnx_model(program, results, tuple(inputs))
        except MorlaxError:
            raise
        except Exception as error:  # torch's exporters raise errors of many kinds
            raise MorlaxError(str(error)[:LONGEST]) from error
    for node in model.graph.node:
        del node.metadata_props[:]  # where in Python each operation comes from
        node.doc_string = ""
    del model.graph.value_info[:]
    return OnnxGraph(model.SerializeToString(), inputs, outputs, dict(recorder.draws))


def check(env: Environment, traced: Traced, generator: torch.Generator) -> float:
    """Compare the graphs with `env.step` for some episodes of random actions.

    Both start each step from the task's state and get its draws. Returns the largest difference,
    relative where numbers exceed 1; raises MorlaxError if it is more than TOLERANCE.
    """
    start = partial(onnxruntime().InferenceSession, providers=["CPUExecutionProvider"])
    sessions = {id(graph): start(graph.onnx) for graph in (traced.before, traced.after)}
    values: dict[str, np.ndarray] = {}  # of all inputs and outputs of the graphs, by name
    simulate, largest = env.physics.step, 0.0

    def copy(names: Iterable[str]) -> None:
        values.update({name: traced.state[name].numpy().copy() for name in names})

    def run(graph: OnnxGraph, draws: list[Tensor], results: Mapping[str, Tensor]) -> None:
        nonlocal largest
        values.update({name: x.numpy() for name, x in zip(graph.draws, draws, strict=True)})
        inputs = {name: values[name] for name in graph.inputs}
        outputs = sessions[id(graph)].run(None, inputs)
        values.update(zip(graph.outputs, outputs, strict=True))
        for name, exact in {**traced.state, **results}.items():
            if name in graph.outputs:
                largest = max(largest, _gap(env, name, exact.numpy(), values[name]))

    def switch() -> None:
        run(traced.before, draws.values, {})
        draws.values.clear()
        simulate()
        copy(ARRAYS)

    for episode in range(EPISODES):
        env.reset()
        for number in range(STEPS):
            phase("checking the traced task", (episode * STEPS + number) / (EPISODES * STEPS))
            uniform = torch.rand(1, env.action_size, generator=generator, dtype=torch.float32)
            action = 2 * uniform - 1 if episode else torch.zeros_like(uniform)
            copy(traced.state)
            values["action"] = action.numpy()
            with Draws() as draws, torch.no_grad(), patch.object(env.physics, "step", switch):
                step = env.step(action)
            results = {name: getattr(step, name) for name in RESULTS}
            results["terms"] = torch.stack([*step.terms.values()], -1)
            run(traced.after, draws.values, results)
    return largest


def _gap(env: Environment, name: str, exact: np.ndarray, traced: np.ndarray) -> float:
    """Return the largest difference, or raise MorlaxError if it is too large."""
    exact, traced = (x.astype(np.float64).ravel() for x in (exact, traced))
    gaps = np.abs(exact - traced) / np.maximum(1.0, np.abs(exact))
    gap = float(np.where(np.isnan(exact) & np.isnan(traced), 0.0, gaps).max(initial=0.0))
    if not gap <= TOLERANCE:
        raise cannot(
            type(env),
            f"its traced {name} differs by {gap:.1e}; keep all state in tensors that are "
            "changed in place, and compute with torch only",
        )
    return gap
