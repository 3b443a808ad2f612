"""The files that a policy can be exported to: how each is written, and read back."""

import io
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor, fx
from torch.export import ExportedProgram

from .envs import MorlaxError

EXTRA_FILE = "morlax_torch.json"
OUTPUT = "action"


class Format(NamedTuple):
    """`write` takes a program and what is to be known of it; `read` gives what then runs."""

    ending: str
    write: Callable[[ExportedProgram, dict[str, Any]], bytes]
    read: Callable[[bytes], Callable[..., Tensor]]


def write_onnx(program: ExportedProgram, about: dict[str, Any]) -> bytes:
    """A model whose metadata_props hold each entry of `about` as JSON."""
    _onnx()
    exported = torch.onnx.export(program, dynamo=True, output_names=[OUTPUT], verbose=False)
    assert exported is not None
    model = exported.model_proto
    for value in [*model.graph.input, *model.graph.output]:
        rows = value.type.tensor_type.shape.dim[0]
        if rows.dim_param:
            rows.dim_param = "batch"
    del model.graph.value_info[:]  # they call the batch size something else
    del model.metadata_props[:]
    for name, value in about.items():
        model.metadata_props.add(key=name, value=json.dumps(value))
    return model.SerializeToString()


def read_onnx(data: bytes) -> Callable[..., Tensor]:
    session = _onnx().InferenceSession(data, providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_inputs()]

    def run(*inputs: Tensor) -> Tensor:
        given = {name: value.numpy() for name, value in zip(names, inputs, strict=True)}
        return torch.from_numpy(session.run([OUTPUT], given)[0])

    return run


def write_torchscript(program: ExportedProgram, about: dict[str, Any]) -> bytes:
    """A traced module with an extra file of JSON."""
    module = program.module(check_guards=False)
    assert isinstance(module, fx.GraphModule) and program.example_inputs is not None
    for node in list(module.graph.nodes):
        if node.target is torch.ops.aten.sym_size.int:  # tracing would write down this one's size
            for user in list(node.users):
                user.args = fx.node.map_arg(user.args, lambda x, own=node: -1 if x is own else x)
            module.graph.erase_node(node)
    plain = fx.GraphModule(module, module.graph)  # without hooks, which cannot be traced
    file = io.BytesIO()
    traced = torch.jit.trace(plain, program.example_inputs[0])
    torch.jit.save(traced, file, {EXTRA_FILE: json.dumps(about)})
    return file.getvalue()


def read_torchscript(data: bytes) -> Callable[..., Tensor]:
    return torch.jit.load(io.BytesIO(data))


def write_torch_export(program: ExportedProgram, about: dict[str, Any]) -> bytes:
    """An exported program with an extra file of JSON."""
    file = io.BytesIO()
    torch.export.save(program, file, extra_files={EXTRA_FILE: json.dumps(about)})
    return file.getvalue()


def read_torch_export(data: bytes) -> Callable[..., Tensor]:
    return torch.export.load(io.BytesIO(data)).module()


FORMATS = {
    "onnx": Format(".onnx", write_onnx, read_onnx),
    "torchscript": Format(".ts", write_torchscript, read_torchscript),
    "torch-export": Format(".pt2", write_torch_export, read_torch_export),
}


def _onnx():
    """onnxruntime, where the whole of the extra is there."""
    try:
        import onnx  # noqa: F401
        import onnxruntime
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise MorlaxError(
            f"ONNX needs {error.name}, which is not there: pip install 'morlax-torch[onnx]'."
        ) from None
    return onnxruntime


@contextmanager
def quiet() -> Iterator[None]:
    """Without what torch has to say about its own exporters."""
    usual = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(usual)
