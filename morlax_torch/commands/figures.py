"""Write figures and a table of evaluated runs for a paper."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..envs import MorlaxError
from .terminal import cli
from .terminal.startup import program
from .terminal.task_arguments import Moved, Trust, call


def command(arguments: Sequence[str]) -> None:
    def main(
        runs: Annotated[
            tuple[str, ...],
            tyro.conf.Positional,
            tyro.conf.arg(metavar="RUN ...", help_behavior_hint="(one or more)"),
        ],
        style: Literal["paper", "screen"] = "paper",
        width: float | None = None,
        output: Path = Path("figures"),
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Write figures of evaluated runs for a paper, and a table of their indicators.

        Writes each run's front with its representative policies, the fronts of each task overlaid
        and the hypervolume during training, as .pdf and .svg, and indicators.tex: a LaTeX table
        (booktabs) with a row for each task and algorithm. Reads front.npz and metrics.csv of the
        runs, and simulates nothing.

        Args:
            runs: Run folders (runs/TASK or latest: the newest run), checkpoint files, or shipped
                policies.
            style: paper: text of 7 points or more, no titles and no 3D. screen: as in reports.
            width: Width of each figure, in inches (None: 3.5 for paper, as in reports for screen).
            output: Output folder.
        """
        if not runs:
            raise MorlaxError(
                "name at least one run: its folder, such as runs/ant/..., or a .pt file."
            )
        from ..reports.printing import write_figures  # imports torch
        from ..runs.loading import trust_run

        for run in runs:
            trust_run(run, trust, env)
        write_figures(runs, output, style, width)
        cli.console.print(f"written: {output}/indicators.tex and figures (pdf, svg)")

    call(main, arguments, program("figures"))
