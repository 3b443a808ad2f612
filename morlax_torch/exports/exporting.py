"""Write policies to files that hold all that a robot needs to know, and check the files."""

import hashlib
import io
import json
import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import Any, Literal, NamedTuple

import mujoco
import torch
from torch import Tensor, fx, nn
from torch.export import ExportedProgram

from ..configuration.tradeoffs import dirichlet_tradeoffs
from ..envs import Environment, MorlaxError, Robot
from ..envs.errors import LONGEST, installation, line, unknown
from ..host.files import AnyPath, write_file
from ..host.phases import phase
from ..host.version import __version__
from ..networks.gaussian import TanhNormal
from ..networks.policy import Policy
from ..runs.loading import find_checkpoint, find_run
from ..runs.progress import best_row, hypervolume_of, read_rows

TOLERANCE = 1e-5  # of actions, which lie in (-1, 1)
BATCHES = (3, 1, 8)  # batch sizes to check; the first is also traced
STEP = 2**-6  # of an action, to measure the slope of its control; exact in binary
EXTRA_FILE = "morlax_torch.json"
OUTPUT = "action"


class FamilyPolicy(nn.Module):
    """A policy with the trade-off as an unchecked input: (B, O) and (m,) to actions (B, A)."""

    def __init__(self, policy: Policy):
        super().__init__()
        self.normalizer, self.actor = policy.agent.observation_normalizer, policy.agent.actor
        self.context = nn.Buffer(policy.agent.context)

    def forward(self, observation: Tensor, tradeoff: Tensor) -> Tensor:
        condition = torch.cat([tradeoff, self.context]) if len(self.context) else tradeoff
        parameters = {name: value[0] for name, value in self.actor(condition[None]).items()}
        return TanhNormal(self.actor.run_one(parameters, self.normalizer(observation))).mode


def export(
    policy: Policy,
    output: AnyPath,
    format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
    tradeoff: Sequence[float] | None = None,
    metadata: dict[str, Any] | None = None,
    robot: Robot | None = None,
) -> float:
    """Write the policy of one trade-off, or of all of them, to `output`.

    The file is read back and compared with the policy.

    Args:
        policy: on the CPU.
        output: the file; an existing one is overwritten.
        format: file format.
        tradeoff: (m,) for a policy (B, O) to (B, A); None keeps the trade-off as an input.
        metadata: plain values for the file's metadata, added to the policy's `manifest`.
        robot: the task's, if it is made already.

    Returns:
        The largest difference between actions of the file and of the policy.

    Raises:
        MorlaxError: a wrong trade-off or format, a network that the format cannot represent, a
            missing extra, or a file that cannot be written.
    """
    if format not in FORMATS:
        raise unknown("format", str(format), FORMATS)
    module = FamilyPolicy(policy) if tradeoff is None else policy.specialize(tradeoff)
    count = 2 if tradeoff is None else 1  # of inputs
    inputs = [_samples(policy, rows)[:count] for rows in BATCHES]
    metadata = {**manifest(policy, tradeoff, robot), **(metadata or {})}
    phase("exporting the policy")
    any_rows = ({0: torch.export.Dim("batch")}, {})[:count]
    plain = torch.autocast("cpu", enabled=False)
    with quiet(), torch.no_grad(), torch.device("cpu"), plain:  # also if scripts set others
        try:
            program = torch.export.export(module, inputs[0], dynamic_shapes=any_rows)
            data = FORMATS[format].write(program.run_decompositions({}), metadata)
        except RuntimeError as error:
            reason = f"cannot represent the network ({line(error)[:LONGEST]})"
            raise MorlaxError(f"{format} {reason}: try another --format.") from error
        run = FORMATS[format].read(data)
        largest = max(float((run(*each) - module(*each)).abs().max()) for each in inputs)
    if not largest < TOLERANCE:
        raise MorlaxError(
            f"as {format}, actions differ from the policy's by up to {largest:.1e}, more than "
            f"{TOLERANCE:.0e}: this format cannot represent the network, try another --format."
        )
    write_file(output, data)
    return largest


def _samples(policy: Policy, rows: int) -> tuple[Tensor, Tensor]:
    """Draw observations (rows, O) as in training, and a trade-off (m,)."""
    agent, shape = policy.agent, (rows, policy.agent.observation_size)
    noise = torch.randn(shape, generator=torch.Generator(), dtype=torch.float32, device="cpu")
    # a different one for each number of rows
    tradeoff = dirichlet_tradeoffs(1, len(policy.objectives), seed=rows)[0]
    return agent.observation_normalizer.inverse(noise), tradeoff


def manifest(
    policy: Policy, tradeoff: Sequence[float] | None = None, robot: Robot | None = None
) -> dict[str, Any]:
    """Return the task, the order and units of inputs and outputs, and the control rate."""
    config, env = policy.config, robot or policy.make_robot()
    parts = env.layout()
    stops = accumulate(part.size for part in parts)
    return {
        "morlax_torch": __version__,
        "task": config.env,
        "scalarization": config.scalarization,
        "objectives": list(policy.objectives),
        "tradeoff": None if tradeoff is None else [float(weight) for weight in tradeoff],
        "control_rate_hz": round(1 / env.dt, 6),
        "observation_size": env.observation_size,
        "observation": [
            {"name": part.name, "slice": [stop - part.size, stop], "unit": part.unit}
            for part, stop in zip(parts, stops, strict=True)
        ],
        "action_size": env.action_size,
        "actuators": actuators(env),
        "control": control(env),
    }


def provenance(run: AnyPath) -> dict[str, Any]:
    """Return the checkpoint's SHA-256, and the best hypervolume of its run if known."""
    checkpoint, metrics = find_checkpoint(run), find_run(run) / "metrics.csv"
    origin: dict[str, Any] = {"sha256": hashlib.sha256(checkpoint.read_bytes()).hexdigest()}
    if metrics.is_file():
        rows = read_rows(metrics)
        origin["best_hypervolume"] = hypervolume_of(rows[best_row(rows)])
    return origin


def actuators(env: Robot) -> list[dict[str, Any]]:
    """Return joint, gear and control range of each actuator, in the order of actions.

    Gear and range are None where an action is not the control of one of the model's actuators. The
    gear is six numbers where it has directions, as at a site or a ball joint.
    """
    targets, model = env.targets(), env.physics.model
    if targets is not None:
        rest = {"gear": None, "control_range": None}
        return [{"name": name, "joint": name, **rest} for name in targets]
    # BRUCE's actuators have no actions of their own, and others may have several controls
    if not env.action_size == model.nu == len(model.actuator_trntype):
        return []
    joint = mujoco.mjtTrn.mjTRN_JOINT
    return [
        {
            "name": motor.name,
            "joint": model.joint(motor.trnid[0]).name if motor.trntype[0] == joint else None,
            "gear": motor.gear.tolist() if motor.gear[1:].any() else float(motor.gear[0]),
            "control_range": motor.ctrlrange.tolist() if motor.ctrllimited[0] else None,
        }
        for motor in map(model.actuator, range(model.nu))
    ]


def control(env: Robot) -> dict[str, list[float]] | None:
    """Return how the task maps an action to control: clip(offset + scale * action, low, high).

    The control is the position of a joint where `actuators` has no gear. None if the mapping has
    another form.
    """
    if (scales := env.scales()) is not None:
        scale, offset = torch.tensor(scales, dtype=torch.float32, device="cpu")
        low, high = offset - scale.abs(), offset + scale.abs()
    elif not isinstance(env, Environment) or env.action_size != env.physics.model.nu:
        return None
    else:

        def control_of(action: Tensor) -> Tensor:
            env.apply(action.expand(1, env.action_size))
            return env.physics.ctrl[0].clone()

        probes = torch.tensor([0.0, -1.0, 1.0, STEP], dtype=torch.float32, device="cpu")
        offset, one_end, other_end, near = map(control_of, probes)
        low, high = torch.minimum(one_end, other_end), torch.maximum(one_end, other_end)
        scale = (near - offset) / STEP
        draws = torch.empty(64, env.action_size, dtype=torch.float32, device="cpu")
        for action in draws.uniform_(-1, 1, generator=torch.Generator()):
            expected = (offset + scale * action).clamp(low, high)
            if not torch.allclose(control_of(action), expected, atol=1e-5):
                return None
            env.physics.step()  # of a mapping that depends on the state, the next draw finds out
    tensors = {"scale": scale, "offset": offset, "low": low, "high": high}
    return {name: tensor.tolist() for name, tensor in tensors.items()}


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
    names: Any = {"input_names": inputs, "output_names": outputs}
    exported: Any = torch.onnx.export(program, dynamo=True, verbose=False, **names)
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
