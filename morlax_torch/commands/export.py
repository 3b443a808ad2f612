"""Write a trained policy to a file that runs without this package."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..terminal import cli
from ..terminal.startup import program
from ..terminal.task_arguments import RunName, Trust, call


def command(arguments: Sequence[str]) -> None:
    def main(
        run: RunName,
        tradeoff: Annotated[str | None, tyro.conf.arg(metavar="0.7,0.3")] = None,
        format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
        output: Path | None = None,
        trust: Trust = False,
    ) -> None:
        """Write the policy of a trade-off to a file that runs without this package.

        The file includes observation normalization and the tanh on actions. Its metadata describe
        inputs and outputs: task, trade-off, order of observations and joints, control rate. The
        file is read back and compared with the policy.

        Args:
            tradeoff: Weight of each objective; weights need not sum to one (None: the trade-off
                stays an input).
            format: File format. onnx needs an extra: pip install 'morlax-torch[onnx]', or in a
                checkout pip install '.[onnx]'.
            output: Output file (None: policy.onnx, .ts or .pt2, or family.* if the trade-off
                is an input; in the run's folder, or in the working directory for a shipped
                policy).
        """
        from ..configuration.tradeoffs import parse_tradeoff
        from ..exports.exporting import export  # imports torch
        from ..exports.formats import FORMATS
        from ..exports.manifest import provenance
        from ..runs.loading import load, own_folder

        policy = load(run, trust=trust)
        weights = None if tradeoff is None else parse_tradeoff(tradeoff, policy.objectives)
        name = ("family" if weights is None else "policy") + FORMATS[format].ending
        place = output or (own_folder(run) or Path()) / name
        largest = export(policy, place, format, weights, {"run": provenance(run)})
        cli.console.print(f"written: {place} (largest difference from the policy: {largest:.0e})")

    call(main, arguments, program("export"))


def main() -> None:
    cli.run(command)
