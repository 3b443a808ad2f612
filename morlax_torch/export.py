"""Write a trained policy to a file that runs without this package."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
import tyro
from torch import Tensor, nn
from torch.export import ExportedProgram

from . import cli
from .envs import MorlaxError
from .files import replacing
from .formats import FORMATS, quiet
from .manifest import manifest, provenance
from .policy import SHIPPED, Policy, find_run, load
from .tradeoffs import dirichlet_tradeoffs, parse_tradeoff

TOLERANCE = 1e-5  # of an action's number, which is in (-1, 1)
BATCHES = (3, 1, 8)  # rows to check with; the first also to trace with


class FamilyPolicy(nn.Module):
    """A policy whose trade-off is an input: observations (B, O) and (m,) to actions (B, A).

    It checks nothing: a trade-off's numbers are not negative and not all zero.
    """

    def __init__(self, policy: Policy):
        super().__init__()
        self.normalizer, self.actor = policy.agent.observation_normalizer, policy.agent.actor

    def forward(self, observation: Tensor, tradeoff: Tensor) -> Tensor:
        parameters = {name: value[0] for name, value in self.actor(tradeoff[None]).items()}
        mean, _ = self.actor.run_one(parameters, self.normalizer(observation)).chunk(2, dim=-1)
        return mean.tanh()


def export(
    policy: Policy,
    output: Path,
    format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
    tradeoff: Sequence[float] | None = None,
    about: dict[str, Any] | None = None,
) -> float:
    """Write the policy of one trade-off, or of all of them, to `output`.

    What is written is read back and compared with the policy; the largest difference is returned.

    Args:
        policy: on the CPU.
        output: the file, overwritten if it is there.
        format: of the file.
        tradeoff: (m,) the one to write, for (B, O) to (B, A); None: it stays an input.
        about: what to write into the file beside the policy's own `manifest`, as plain values.

    Raises:
        MorlaxError: a wrong trade-off, a network that this format cannot hold, a missing extra,
            or a file that cannot be written.
    """
    chosen = FORMATS[format]
    module = FamilyPolicy(policy) if tradeoff is None else policy.specialize(tradeoff)
    inputs = [samples(policy, rows, tradeoff is None) for rows in BATCHES]
    about = {**manifest(policy, tradeoff), **(about or {})}
    with quiet(), torch.no_grad():
        data = chosen.write(program_of(module, inputs[0]), about)
        run = chosen.read(data)
        differences = [run(*given.values()) - module(*given.values()) for given in inputs]
    largest = max(float(difference.abs().max()) for difference in differences)
    if not largest < TOLERANCE:
        raise MorlaxError(
            f"as {format}, actions differ from the policy's by up to {largest:.1e}, more than "
            f"{TOLERANCE:.0e}: this network cannot be written so, try another --format."
        )
    with replacing(output) as file:
        file.write(data)
    return largest


def program_of(module: nn.Module, inputs: dict[str, Tensor]) -> ExportedProgram:
    """The module as a graph of plain operations on any number of rows."""
    shapes = {name: {} for name in inputs} | {"observation": {0: torch.export.Dim("batch")}}
    program = torch.export.export(module, tuple(inputs.values()), dynamic_shapes=shapes)
    return program.run_decompositions({})


def samples(policy: Policy, rows: int, with_tradeoff: bool) -> dict[str, Tensor]:
    """Inputs by name: observations (rows, O) like those of the training, a trade-off (m,)."""
    noise = torch.randn(rows, policy.agent.observation_size, generator=torch.Generator())
    normalizer = policy.agent.observation_normalizer
    inputs = {"observation": normalizer.inverse(noise)}
    if with_tradeoff:  # another one for each number of rows
        inputs["tradeoff"] = dirichlet_tradeoffs(1, len(policy.objectives), seed=rows)[0]
    return inputs


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        tradeoff: Annotated[str | None, tyro.conf.arg(metavar="0.7,0.3")] = None,
        format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
        output: Path | None = None,
    ) -> None:
        """Write the policy of a trade-off to a file that runs without this package.

        Observations are normalised and actions squashed inside. The file says what it takes and
        gives: task, trade-off, order of observations and joints, control rate. What was written
        is read back and compared with the policy.

        Args:
            run: A run's folder (its best checkpoint), a checkpoint file, or a shipped policy.
            tradeoff: How much each objective matters; they need not sum to one (none: the
                trade-off stays an input).
            format: onnx needs an extra: pip install 'morlax-torch[onnx]'.
            output: The file (None: policy.onnx, .ts or .pt2 in the run's folder, family.* where
                the trade-off is an input; here for a shipped policy).
        """
        policy = load(run)
        weights = None if tradeoff is None else parse_tradeoff(tradeoff, policy.objectives)
        name = ("family" if weights is None else "policy") + FORMATS[format].ending
        place = output or _usual_folder(run) / name
        largest = export(policy, place, format, weights, {"run": provenance(run)})
        cli.console.print(f"written: {place} (largest difference from the policy: {largest:.0e})")

    tyro.cli(main, args=arguments, prog="python -m morlax_torch.export")


def _usual_folder(run: Path) -> Path:
    folder = find_run(run)
    return Path() if folder.parent == SHIPPED else folder


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
