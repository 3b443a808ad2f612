"""Trace a task's control step into two graphs, before the physics and after it, and check them."""

import operator
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, NamedTuple
from unittest.mock import patch

import mujoco
import numpy as np
import torch
from torch import Tensor, fx, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from ...envs import Environment, MorlaxError
from ...envs.errors import LONGEST
from ...envs.physics.mujoco import MujocoPhysics
from ...exports.exporting import onnx_model, onnxruntime, quiet
from ...host.phases import phase

# of `Physics`, and their names in mjData
ARRAYS = {"qpos": "qpos", "qvel": "qvel", "act": "act", "ctrl": "ctrl"}
ARRAYS |= {"warmstart": "qacc_warmstart", "sensors": "sensordata"}
# what else of the physics a task may write
PARTS = "mocap_pos", "mocap_quat", "qfrc_applied", "xfrc_applied", "eq_active"
ARRAYS |= {name: name for name in PARTS}
RESULTS = ("observation", "reward", "terminated", "truncated")  # of a `TimeStep`
STEPS, EPISODES = 60, 3  # of the check
TOLERANCE = 1e-4  # absolute plus relative

aten = torch.ops.aten
UNIFORM, NORMAL = {"from": 0.0, "to": 1.0}, {"mean": 0.0, "std": 1.0}
# operations whose draws a page can repeat: kind, uniform and integer in [from, to), and defaults
RANDOM = {
    "aten::uniform_": ("uniform", UNIFORM),
    "aten::normal_": ("normal", NORMAL),
    "aten::random_.from": ("integer", UNIFORM),
    "aten::rand.generator": ("uniform", UNIFORM),
    "aten::randn.generator": ("normal", NORMAL),
}


def storage(tensor: Tensor) -> int:
    """Return the identity of the memory that a tensor is a view of."""
    return tensor.untyped_storage()._cdata


def flat(tensor: Tensor) -> Tensor:
    """Return a view (size,) of all the memory that a tensor is a view of."""
    return torch.empty(0, dtype=tensor.dtype).set_(tensor.untyped_storage())


def bound(func: Any, args: tuple, kwargs: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of an operation by name."""
    names = (argument.name for argument in func._schema.arguments)
    return dict(zip(names, args, strict=False)) | kwargs


def written(func: Any, args: tuple, kwargs: dict[str, Any]) -> list[Tensor]:
    """Return the tensors that an operation changes."""
    values, schema = bound(func, args, kwargs), func._schema.arguments
    changed = [values.get(a.name) for a in schema if a.alias_info and a.alias_info.is_write]
    return [value for value in tree_leaves(changed) if isinstance(value, Tensor)]


class Watch(TorchDispatchMode):
    """Finds the tensors that are changed in place but existed before, and random numbers."""

    def __init__(self) -> None:
        super().__init__()
        self._new: dict[int, Tensor] = {}
        self.storages: dict[int, Tensor] = {}  # changed ones by identity, as views (size,)
        self.draws: list[Tensor] = []  # random numbers in order

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        result = func(*args, **(kwargs or {}))
        inputs = {storage(x) for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)}
        for tensor in tree_leaves(result):
            if isinstance(tensor, Tensor) and storage(tensor) not in inputs:
                self._new[storage(tensor)] = tensor  # kept, so that no other gets its identity
        for tensor in written(func, args, kwargs or {}):
            if storage(tensor) not in self._new:
                self.storages.setdefault(storage(tensor), flat(tensor))
        if torch.Tag.nondeterministic_seeded in func.tags:
            self.draws.append(result.clone())
        return result


class Recorder(TorchDispatchMode):
    """Records operations into a graph of the persisting tensors, which it reads and changes.

    The `state` are the storages (size,) of these tensors by name, so that views stay views. Tensors
    that no one changes become constants. Results of a `former` recorder may be needed here.
    """

    def __init__(self, state: dict[str, Tensor], former: "Recorder | None" = None):
        super().__init__()
        self.graph, self.root, self.former = fx.Graph(), nn.Module(), former
        self.inputs: dict[str, Tensor] = {}  # in order, with values to trace with
        self.outputs: dict[str, Any] = {}  # name -> node; the changed state among them
        self.draws: dict[str, dict[str, Any]] = {}  # kind and parameters by name
        self._nodes: dict[int, tuple[fx.Node, Tensor]] = {}  # id -> node, and the tensor itself
        self._names = {storage(values): name for name, values in state.items()}
        self._state = state
        self._bases: dict[str, fx.Node] = {}
        self._dynamic: set[fx.Node] = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if func is aten._local_scalar_dense.default:
            if self._node(args[0]) in self._dynamic:
                raise MorlaxError("it reads a tensor's number into Python (.item(), or if)")
            return func(*args)
        if torch.Tag.nondeterministic_seeded in func.tags:
            return self._draw(func, args, kwargs)
        nodes = tree_map(lambda x: self._node(x) if isinstance(x, Tensor) else x, (args, kwargs))
        result = func(*args, **kwargs)
        node = self._call(func, *nodes)
        self._keep(func, args, kwargs, result, node)
        return result

    def output(self, name: str, tensor: Tensor) -> None:
        self.outputs[name] = self._node(tensor)

    def module(self) -> fx.GraphModule:
        """Return the graph as a module from `inputs` to `outputs`."""
        results = [self._call(aten.clone.default, (x,), {}) for x in self.outputs.values()]
        self.graph.output(tuple(results))
        return fx.GraphModule(self.root, self.graph)

    def _draw(self, func: Any, args: tuple, kwargs: dict[str, Any]) -> Tensor:
        schema = func._schema
        operation = f"{schema.name}.{schema.overload_name}".rstrip(".")
        if operation not in RANDOM:
            raise MorlaxError(f"it draws random numbers with torch's {schema.name[6:]}")
        (kind, defaults), values = RANDOM[operation], bound(func, args, kwargs)
        parameters = [float(values.get(name, x)) for name, x in defaults.items()]
        result, name = func(*args, **kwargs), f"random_{len(self.draws)}"
        self.draws[name] = {"kind": kind, "parameters": parameters}
        drawn = self._placeholder(name, result)
        if schema.name.endswith("_"):
            drawn = self._call(aten.copy_.default, (self._node(args[0]), drawn), {})
        self._keep(func, args, kwargs, result, drawn)
        return result

    def _call(self, func: Any, args: tuple, kwargs: dict[str, Any]) -> fx.Node:
        node = self.graph.call_function(func, args, kwargs)
        if any(x in self._dynamic for x in node.all_input_nodes):
            self._dynamic.add(node)
        return node

    def _keep(self, func: Any, args: tuple, kwargs: dict, result: Any, node: fx.Node) -> None:
        """Remember the node of an operation's result, and which state it has changed."""
        for tensor in written(func, args, kwargs):
            name = self._names.get(storage(tensor))
            if name is not None:
                self.outputs[name] = self._bases[name]
        if isinstance(result, Tensor):
            self._nodes[id(result)] = node, result
        elif isinstance(result, (list, tuple)):
            for index, part in enumerate(result):
                if isinstance(part, Tensor):
                    picked = self._call(operator.getitem, (node, index), {})
                    self._nodes[id(part)] = picked, part

    def _node(self, tensor: Tensor) -> fx.Node:
        if id(tensor) in self._nodes:
            return self._nodes[id(tensor)][0]
        name, former = self._names.get(storage(tensor)), self.former
        if name is not None:
            node = self._view(name, tensor)
        elif former is not None and id(tensor) in former._nodes:
            name = f"carried_{len(self.inputs)}"
            former.output(name, tensor)
            node = self._placeholder(name, tensor)
        else:
            name = f"constant_{len(list(self.root.buffers()))}"
            self.root.register_buffer(name, tensor.detach().clone())
            node = self.graph.get_attr(name)
        self._nodes[id(tensor)] = node, tensor
        return node

    def _view(self, name: str, tensor: Tensor) -> fx.Node:
        if name not in self._bases:
            base = self._placeholder(name, self._state[name])
            self._bases[name] = self._call(aten.clone.default, (base,), {})
        if tensor.dtype != self._state[name].dtype or not tensor.is_contiguous():
            raise MorlaxError("it keeps a strided view of a tensor that changes")
        begin, end = tensor.storage_offset(), tensor.storage_offset() + tensor.numel()
        part = self._call(aten.slice.Tensor, (self._bases[name], 0, begin, end), {})
        return self._call(aten.view.default, (part, list(tensor.shape)), {})

    def _placeholder(self, name: str, tensor: Tensor) -> fx.Node:
        self.inputs[name] = tensor.detach().clone()
        node = self.graph.placeholder(name)
        self._dynamic.add(node)
        return node


class PagePhysics(MujocoPhysics):
    """One world whose tensors are float32, for browsers; MuJoCo itself computes in float64."""

    def __init__(self, model: mujoco.MjModel, substeps: int):
        super().__init__(model, 1, substeps)
        own = {name: getattr(self, name) for name in ARRAYS if name not in PARTS}
        parts = {name: self.part(name) for name in PARTS if name in self.parts}
        self._exact = {name: x.numpy() for name, x in (own | parts).items() if name != "sensors"}
        self.arrays = {name: x.to(torch.float32) for name, x in (own | parts).items()}  # (1, ...)
        for name in parts:
            self.parts[name] = self.arrays[name], self.parts[name][1].to(torch.float32)
        # around `__setattr__`, which refuses other tensors than the simulator's own
        vars(self).update({name: self.arrays[name] for name in own})

    def step(self) -> None:
        for name, exact in self._exact.items():  # by NumPy, because a recorder must not see it
            exact[:] = self.arrays[name].numpy()
        super().step()
        for name, exact in self._exact.items():
            self.arrays[name].numpy()[:] = exact


class OnnxGraph(NamedTuple):
    """An ONNX model, and the order of its inputs and outputs."""

    onnx: bytes
    inputs: dict[str, dict[str, Any]]  # shape and type by name
    outputs: tuple[str, ...]
    draws: dict[str, dict[str, Any]]  # kind and parameters of the inputs that are random


class Traced(NamedTuple):
    """A control step as graphs; both read and change the state by name.

    `before` maps an action to controls, `after` the new physics to observation, rewards and end.
    """

    before: OnnxGraph
    after: OnnxGraph
    state: dict[str, Tensor]  # (size,) physics and task state: views of the environment's
    terms: tuple[str, ...]  # names of the reward terms


def trace(env: Environment) -> Traced:
    """Trace `env.step` and check the graphs; raises MorlaxError if none can express the task."""
    try:
        traced = _traced(env)
        _check(env, traced)
    except MorlaxError as error:
        raise cannot(type(env), str(error)) from None
    return traced


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
    with Watch() as watch, torch.no_grad():
        env.step(action)
        env.reset()
    others = [values for memory, values in watch.storages.items() if memory not in named]
    return state | {f"state_{number}": values for number, values in enumerate(others)}


def _traced(env: Environment) -> Traced:
    action = torch.zeros(1, env.action_size, dtype=torch.float32)
    state = persisting(env, action)
    env.reset()
    inputs = {**state, "action": flat(action)}
    before = Recorder(inputs)
    after = Recorder(inputs, before)
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
    return Traced(_graph(before), _graph(after), state, tuple(step.terms))


def _graph(recorder: Recorder) -> OnnxGraph:
    module = recorder.module()
    inputs, outputs = recorder.inputs, tuple(recorder.outputs)
    with quiet(), torch.no_grad():
        try:
            program = torch.export.export(module, tuple(inputs.values())).run_decompositions({})
            results = [f"next_{name}" for name in outputs]  # ONNX needs names of their own
            model = onnx_model(program, results, tuple(inputs))
        except Exception as error:  # torch's exporters raise errors of many kinds
            raise MorlaxError(str(error)[:LONGEST]) from error
    for node in model.graph.node:
        del node.metadata_props[:]  # where in Python each operation comes from
        node.doc_string = ""
    del model.graph.value_info[:]
    about = {name: {"shape": list(x.shape), "type": str(x.dtype)[6:]} for name, x in inputs.items()}
    return OnnxGraph(model.SerializeToString(), about, outputs, recorder.draws)


def _check(env: Environment, traced: Traced) -> None:
    """Compare the graphs with `env.step`, from the same states, actions and draws."""
    start = partial(onnxruntime().InferenceSession, providers=["CPUExecutionProvider"])
    sessions = {id(graph): start(graph.onnx) for graph in (traced.before, traced.after)}
    values: dict[str, np.ndarray] = {}  # of all inputs and outputs of the graphs, by name
    simulate, generator = env.physics.step, torch.Generator().manual_seed(0)

    def copy(names: Iterable[str]) -> None:
        values.update({name: traced.state[name].numpy().copy() for name in names})

    def run(graph: OnnxGraph, draws: list[Tensor], results: Mapping[str, Tensor]) -> None:
        values.update({name: x.numpy() for name, x in zip(graph.draws, draws, strict=True)})
        inputs = {name: values[name] for name in graph.inputs}
        outputs = sessions[id(graph)].run(None, inputs)
        values.update(zip(graph.outputs, outputs, strict=True))
        for name, exact in {**traced.state, **results}.items():
            if name in graph.outputs:
                _compare(name, exact.numpy().ravel(), values[name].ravel())

    def switch() -> None:
        run(traced.before, watch.draws, {})
        watch.draws.clear()
        simulate()
        copy(env.physics.arrays)

    for episode in range(EPISODES):
        env.reset()
        for number in range(STEPS):
            phase("checking the traced task", (episode * STEPS + number) / (EPISODES * STEPS))
            uniform = torch.rand(1, env.action_size, generator=generator, dtype=torch.float32)
            action = 2 * uniform - 1 if episode else torch.zeros_like(uniform)
            copy(traced.state)
            values["action"] = action.numpy().ravel()
            with Watch() as watch, torch.no_grad(), patch.object(env.physics, "step", switch):
                step = env.step(action)
            results = {name: getattr(step, name) for name in RESULTS}
            results["terms"] = torch.stack([*step.terms.values()], -1)
            run(traced.after, watch.draws, results)


def _compare(name: str, exact: np.ndarray, traced: np.ndarray) -> None:
    exact, traced = exact.astype(np.float64), traced.astype(np.float64)
    if not np.allclose(traced, exact, TOLERANCE, TOLERANCE, equal_nan=True):
        raise MorlaxError(
            f"its traced {name} differs by {np.abs(exact - traced).max():.1e}; keep all state in "
            "tensors that are changed in place, and compute with torch only"
        )
