"""Write a trained policy to a file that runs without this package."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from .exports.exporting import export
from .exports.formats import FORMATS
from .exports.manifest import provenance
from .runs.loading import SHIPPED, find_run, load
from .terminal import cli
from .tradeoffs import parse_tradeoff


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
