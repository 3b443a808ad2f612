"""The export formats: how to write each, and how to read it back."""

import io
import json
import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor, fx
from torch.export import ExportedProgram

from ..envs import MorlaxError
from ..envs.errors import installation

EXTRA_FILE = "morlax_torch.json"
OUTPUT = "action"


class Format(NamedTuple):
    ending: str
    write: Callable[[ExportedProgram, dict[str, Any]], bytes]  # with the file's metadata
    read: Callable[[bytes], Callable[..., Tensor]]  # what maps the program's inputs to actions


def write_onnx(program: ExportedProgram, metadata: dict[str, Any]) -> bytes:
    """Return an ONNX model with each entry of `metadata` as JSON in its metadata_props."""
    model = onnx_model(program, [OUTPUT])
    for value in [*model.graph.input, *model.graph.output]:
        rows = value.type.tensor_type.shape.dim[0]
        if rows.dim_param:
            rows.dim_param = "batch"
    del model.graph.value_info[:]  # they have another name for the batch size
    del model.metadata_props[:]
    for name, value in metadata.items():
        model.metadata_props.add(key=name, value=json.dumps(value))
    return model.SerializeToString()


def onnx_model(
    program: ExportedProgram, outputs: Sequence[str], inputs: Sequence[str] | None = None
) -> Any:
    """Return a program as an ONNX ModelProto, with these names of outputs and inputs."""
    onnxruntime()
    exported = torch.onnx.export(
        program, dynamo=True, verbose=False, input_names=inputs, output_names=outputs
    )
    assert exported is not None
    return exported.model_proto


def read_onnx(data: bytes) -> Callable[..., Tensor]:
    session = onnxruntime().InferenceSession(data, providers=["CPUExecutionProvider"])
    names = [value.name for value in session.get_inputs()]

    def run(*inputs: Tensor) -> Tensor:
        arrays = {name: value.numpy() for name, value in zip(names, inputs, strict=True)}
        return torch.from_numpy(session.run([OUTPUT], arrays)[0])

    return run


def write_torchscript(program: ExportedProgram, metadata: dict[str, Any]) -> bytes:
    """Return a traced module with `metadata` in an extra JSON file."""
    module = program.module(check_guards=False)
    assert isinstance(module, fx.GraphModule) and program.example_inputs is not None
    for node in list(module.graph.nodes):
        if node.target is torch.ops.aten.sym_size.int:  # tracing would fix the batch size
            for user in list(node.users):
                user.args = fx.node.map_arg(user.args, lambda x, size=node: -1 if x is size else x)
            module.graph.erase_node(node)
    plain = fx.GraphModule(module, module.graph)  # without hooks, which cannot be traced
    file = io.BytesIO()
    traced = torch.jit.trace(plain, program.example_inputs[0])
    torch.jit.save(traced, file, {EXTRA_FILE: json.dumps(metadata)})
    return file.getvalue()


def write_torch_export(program: ExportedProgram, metadata: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    torch.export.save(program, file, extra_files={EXTRA_FILE: json.dumps(metadata)})
    return file.getvalue()


FORMATS = {
    "onnx": Format(".onnx", write_onnx, read_onnx),
    "torchscript": Format(".ts", write_torchscript, lambda data: torch.jit.load(io.BytesIO(data))),
    "torch-export": Format(
        ".pt2", write_torch_export, lambda data: torch.export.load(io.BytesIO(data)).module()
    ),
}


def onnxruntime() -> Any:
    """Return onnxruntime; raises MorlaxError unless the whole extra is installed."""
    try:
        import onnx  # noqa: F401
        import onnxruntime as runtime
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise MorlaxError(
            f"ONNX needs {error.name}, which is not installed: {installation('onnx')}."
        ) from None
    return runtime


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress the warnings that torch's exporters log about themselves."""
    usual = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        logging.disable(usual)
