"""Write figures and a table of evaluated runs for a paper."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from pydantic import Field

from .terminal import cli
from .terminal.arguments import OfRuns, parse


class Figures(OfRuns):
    """Write figures of evaluated runs for a paper, and a table of their indicators.

    Writes each run's front with its representative policies, the fronts of each task overlaid and
    the hypervolume during training, as .pdf and .svg, and indicators.tex: a LaTeX table (booktabs)
    with a row for each task, algorithm and config. Reads front.npz and metrics.csv of the runs,
    and simulates nothing.
    """

    style: Literal["paper", "screen"] = "paper"
    """paper: text of 7 points or more, no titles and no 3D. screen: as in reports."""
    width: float | None = Field(default=None, ge=2, le=20)
    """Width of each figure, in inches (None: 3.5 for paper, as in reports for screen)."""
    output: Path = Path("figures")
    """Output folder."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Figures, arguments)
    from ..reports.page import write_figures  # imports torch
    from ..runs.loading import trust_run

    for run in options.runs:
        trust_run(run, options.trust, options.env)
    write_figures(options.runs, options.output, options.style, options.width)
    cli.console.print(f"written: {options.output}/indicators.tex and figures (pdf, svg)")
