"""Record torch operations as graphs whose inputs are the tensors that persist."""

import operator
from typing import Any, NamedTuple

import torch
from torch import Tensor, fx, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from ...envs import MorlaxError

aten = torch.ops.aten
UNIFORM, NORMAL = {"from": 0.0, "to": 1.0}, {"mean": 0.0, "std": 1.0}
RANDOM = {  # operations whose draws a page can repeat: kind, and parameters with their defaults
    "aten::uniform_": ("uniform", UNIFORM),
    "aten::normal_": ("normal", NORMAL),
    "aten::random_.from": ("integer", UNIFORM),
    "aten::rand.generator": ("uniform", UNIFORM),
    "aten::randn.generator": ("normal", NORMAL),
}


class Draw(NamedTuple):
    """Numbers that an operation draws: uniform and integer in [low, high), or normal."""

    kind: str
    parameters: tuple[float, ...]  # low and high, or mean and standard deviation


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
        self.outputs: dict[str, Any] = {}  # name -> node
        self.carried: dict[str, Tensor] = {}  # results of `former` that are inputs here
        self.draws: dict[str, Draw] = {}
        self._nodes: dict[int, tuple[fx.Node, Tensor]] = {}  # id -> node, and the tensor itself
        self._names = {storage(values): name for name, values in state.items()}
        self._state = state
        self._bases: dict[str, fx.Node] = {}
        self._changed: dict[str, None] = {}
        self._dynamic: set[fx.Node] = set()
        # inputs are found while recording, but belong before it
        self._end_of_inputs = self.graph.call_function(torch.zeros, ((),))

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
        """Return the graph as a module of `inputs`; it also returns the changed state."""
        for name in self._changed:
            self.outputs[name] = self._bases[name]
        results = [self._call(aten.clone.default, (x,), {}) for x in self.outputs.values()]
        self.graph.output(tuple(results))
        self.graph.erase_node(self._end_of_inputs)
        return fx.GraphModule(self.root, self.graph)

    def _draw(self, func: Any, args: tuple, kwargs: dict[str, Any]) -> Tensor:
        schema = func._schema
        operation = f"{schema.name}.{schema.overload_name}".rstrip(".")
        if operation not in RANDOM:
            raise MorlaxError(f"it draws random numbers with torch's {schema.name[6:]}")
        (kind, defaults), values = RANDOM[operation], bound(func, args, kwargs)
        parameters = tuple(float(values.get(name, x)) for name, x in defaults.items())
        result, name = func(*args, **kwargs), f"random_{len(self.draws)}"
        self.draws[name] = Draw(kind, parameters)
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
                self._changed[name] = None
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
            name = f"carried_{len(self.carried)}"
            node = self._placeholder(name, tensor)
            self.carried[name] = tensor
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
        with self.graph.inserting_before(self._end_of_inputs):
            node = self.graph.placeholder(name)
        self._dynamic.add(node)
        return node
