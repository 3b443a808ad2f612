"""Write a trained policy to a file that runs without this package."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..envs import MorlaxError
from .terminal import cli
from .terminal.live import Live
from .terminal.startup import program
from .terminal.task_arguments import (
    Moved,
    RunName,
    Trust,
    call,
)


def command(arguments: Sequence[str]) -> None:
    def main(
        run: RunName,
        tradeoff: Annotated[str | None, tyro.conf.arg(metavar="0.7,0.3")] = None,
        format: Literal["onnx", "torchscript", "torch-export"] = "onnx",
        output: Path | None = None,
        slew: float | None = None,
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Write the policy of a trade-off to a file that runs without this package.

        The file includes observation normalization and the tanh on actions. Its metadata describe
        inputs and outputs: task, trade-off, order of observations and joints, control rate. The
        file is read back and compared with the policy. If actions are positions of joints, as in
        mjlab's tasks, deploy.yaml and robot.zip are written beside it, for a controller and for
        morlax play.

        Args:
            tradeoff: Weight of each objective, or @NAME of a bookmark; weights need not sum to one
                (None: the trade-off stays an input).
            format: File format. onnx needs an extra: pip install 'morlax-torch[onnx]', or in a
                checkout pip install '.[onnx]'.
            output: Output file (None: policy.onnx, .ts or .pt2, or family.* if the trade-off
                is an input; in the run's folder, or in the working directory for a shipped
                policy).
            slew: Largest change of a trade-off's weight per second, for deploy.yaml (None: any).
        """
        if slew is not None and not 0 < slew < math.inf:
            raise MorlaxError(f"--slew must be a positive change per second, not {slew:g}.")
        if slew is not None and tradeoff is not None:
            raise MorlaxError("--slew limits a trade-off that changes: leave --tradeoff out.")
        with Live():
            from ..exports.deployment import SETTINGS, deploy
            from ..exports.exporting import export, provenance, robot_of  # imports torch
            from ..exports.formats import FORMATS
            from ..host.files import make_folder
            from ..runs.bookmarks import tradeoff_of
            from ..runs.loading import load, objectives_of, own_folder

            weights = None if tradeoff is None else tradeoff_of(tradeoff, run, objectives_of(run))
            policy = load(run, trust=trust, env=env)
            name = ("family" if weights is None else "policy") + FORMATS[format].ending
            place = output or (own_folder(run) or Path()) / name
            robot, about = robot_of(policy), {"run": provenance(run)}
            if slew is not None and robot.scales() is None:
                raise MorlaxError(
                    f"--slew is for {SETTINGS}, which {policy.config.env} does not have, because "
                    "its actions are not positions of joints."
                )
            make_folder(place.parent)
            largest = export(policy, place, format, weights, about, robot)
            lacks = deploy(robot, place, policy.config.env, policy.objectives, weights, slew)
        cli.console.print(f"written: {place} (largest difference from the policy: {largest:.0e})")
        if lacks is not None:
            cli.console.print(
                f"written: {place.with_name(SETTINGS)}, for morlax play {place.parent}"
            )
        for sentence in lacks or ():
            cli.console.print(sentence)

    call(main, arguments, program("export"))
