"""Write policies to files, and check the files."""

from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.export import ExportedProgram

from ..configuration.tradeoffs import dirichlet_tradeoffs
from ..envs import MorlaxError, Robot
from ..envs.errors import unknown
from ..host.files import AnyPath, write_file
from ..host.phases import phase
from ..networks.gaussian import TanhNormal
from ..networks.policy import Policy
from .formats import FORMATS, quiet
from .manifest import manifest

TOLERANCE = 1e-5  # of actions, which lie in (-1, 1)
BATCHES = (3, 1, 8)  # batch sizes to check; the first is also traced


class FamilyPolicy(nn.Module):
    """A policy with the trade-off as an input: observations (B, O) and (m,) to actions (B, A).

    It checks no input: the trade-off must not be negative or all zero.
    """

    def __init__(self, policy: Policy):
        super().__init__()
        self.normalizer, self.actor = policy.agent.observation_normalizer, policy.agent.actor
        self.context: Tensor
        self.register_buffer("context", policy.agent.context)

    def forward(self, observation: Tensor, tradeoff: Tensor) -> Tensor:
        condition = torch.cat([tradeoff, self.context]) if len(self.context) else tradeoff
        parameters = {name: value[0] for name, value in self.actor(condition[None]).items()}
        normalizer = self.normalizer.of(self.actor, tradeoff)
        return TanhNormal(self.actor.run_one(parameters, normalizer(observation))).mode


def export(
    policy: Policy,
    output: AnyPath,
    format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
    tradeoff: Sequence[float] | None = None,
    about: dict[str, Any] | None = None,
    robot: Robot | None = None,
) -> float:
    """Write the policy of one trade-off, or of all of them, to `output`.

    The file is read back and compared with the policy.

    Args:
        policy: on the CPU.
        output: the file; an existing one is overwritten.
        format: file format.
        tradeoff: (m,) for a policy (B, O) to (B, A); None keeps the trade-off as an input.
        about: plain values for the file's metadata, added to the policy's `manifest`.
        robot: the task's, if it is made already.

    Returns:
        The largest difference between actions of the file and of the policy.

    Raises:
        MorlaxError: a wrong trade-off or format, a network that the format cannot represent, a
            missing extra, or a file that cannot be written.
    """
    if format not in FORMATS:
        raise unknown("format", str(format), FORMATS)
    chosen = FORMATS[format]
    module = FamilyPolicy(policy) if tradeoff is None else policy.specialize(tradeoff)
    inputs = [samples(policy, rows, tradeoff is None) for rows in BATCHES]
    about = {**manifest(policy, tradeoff, robot), **(about or {})}
    phase("exporting the policy")
    with quiet(), torch.no_grad():
        data = chosen.write(program_of(module, inputs[0]), about)
        run = chosen.read(data)
        differences = [run(*given.values()) - module(*given.values()) for given in inputs]
    largest = max(float(difference.abs().max()) for difference in differences)
    if not largest < TOLERANCE:
        raise MorlaxError(
            f"as {format}, actions differ from the policy's by up to {largest:.1e}, more than "
            f"{TOLERANCE:.0e}: this format cannot represent the network, try another --format."
        )
    write_file(output, data)
    return largest


def program_of(module: nn.Module, inputs: dict[str, Tensor]) -> ExportedProgram:
    """Trace the module into a graph of plain operations on any number of rows."""
    shapes = {name: {} for name in inputs} | {"observation": {0: torch.export.Dim("batch")}}
    program = torch.export.export(module, tuple(inputs.values()), dynamic_shapes=shapes)
    return program.run_decompositions({})


def samples(policy: Policy, rows: int, with_tradeoff: bool) -> dict[str, Tensor]:
    """Draw inputs by name: observations (rows, O) as in training, and a trade-off (m,)."""
    agent = policy.agent
    shape = rows, agent.observation_size
    noise = torch.randn(shape, generator=torch.Generator(), dtype=torch.float32)
    # a different one for each number of rows
    tradeoff = dirichlet_tradeoffs(1, len(policy.objectives), seed=rows)[0]
    normalizer = agent.observation_normalizer.of(agent.actor, tradeoff)
    inputs = {"observation": normalizer.inverse(noise), "tradeoff": tradeoff}
    return inputs if with_tradeoff else {"observation": inputs["observation"]}
