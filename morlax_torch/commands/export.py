"""Write a trained policy to a file that runs without this package."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import PositiveFloat

from ..envs import MorlaxError
from .terminal import cli
from .terminal.arguments import OfRun, arg, parse


class Export(OfRun):
    """Write the policy of a trade-off to a file that runs without this package.

    The file includes observation normalization and the tanh on actions. Its metadata describe
    inputs and outputs: task, trade-off, order of observations and joints, control rate. The file is
    read back and compared with the policy. For tasks of mjlab whose
    actions are positions of joints, deploy.yaml and robot.zip are written beside it, for a
    controller and, with a file of ONNX, for morlax play.
    """

    tradeoff: Annotated[str | None, arg(metavar="0.7,0.3")] = None
    """Weight of each objective, or @NAME of a bookmark; weights need not sum to one (None: the
    trade-off stays an input)."""
    format: Literal["onnx", "torchscript", "torch-export"] = "onnx"
    """File format. onnx needs an extra: pip install 'morlax-torch[onnx]', or in a checkout pip
    install '.[onnx]'."""
    output: Path | None = None
    """Output file (None: policy.onnx, .ts or .pt2, or family.* if the trade-off is an input; in the
    run's folder, or in the working directory for a shipped policy)."""
    slew: PositiveFloat | None = None
    """Largest change of a trade-off's weight per second, for deploy.yaml (None: any)."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Export, arguments)
    if options.slew is not None and options.tradeoff is not None:
        raise MorlaxError("--slew limits a trade-off that changes: leave --tradeoff out.")
    with cli.Live():
        from ..exports.deployment import SETTINGS, deploy
        from ..exports.exporting import FORMATS, export, provenance  # imports torch
        from ..host.files import make_folder
        from ..runs.loading import load, own_folder, tradeoff_of

        run, weights = options.run, None
        if options.tradeoff is not None:
            weights = tradeoff_of(options.tradeoff, run)
        policy = load(run, trust=options.trust, env=options.env)
        ending = FORMATS[options.format].ending
        name = ("family" if weights is None else "policy") + ending
        file = options.output or (own_folder(run) or Path()) / name
        for other, kind in FORMATS.items():
            if file.suffix == kind.ending != ending:
                raise MorlaxError(
                    f"{file} would hold {options.format}: end its name in {ending}, or add "
                    f"--format {other}."
                )
        robot, facts = policy.make_robot(), {"run": provenance(run)}
        if options.slew is not None and robot.scales() is None:
            raise MorlaxError(
                f"--slew is for {SETTINGS}, which {policy.config.env} does not have: only "
                "tasks of mjlab whose actions are positions of joints do."
            )
        make_folder(file.parent)
        largest = export(policy, file, options.format, weights, facts, robot)
        lacks = deploy(robot, file, policy.config.env, policy.objectives, weights, options.slew)
    cli.console.print(f"written: {file} (largest difference from the policy: {largest:.0e})")
    if lacks is not None:
        use = f", for morlax play {file.parent}" if options.format == "onnx" else ""
        cli.console.print(f"written: {file.with_name(SETTINGS)}{use}")
    for sentence in lacks or ():
        cli.console.print(sentence)
