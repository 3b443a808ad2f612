"""Evaluate trained runs: fronts, indicators, figures and a report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from ..configuration.sections import Protocol
from ..envs import MorlaxError
from .terminal import cli
from .terminal.arguments import Device, Positional, Trusting, arg, parse
from .terminal.process import typed


class Evaluate(Trusting):
    """Evaluate the policies of many trade-offs and print the indicators.

    Says how good the front is and what to do next. Writes each run's front (front.npz, front.csv),
    figures (png and pdf), indicators.csv and report.html, a self-contained file. Several runs are
    compared: one figure overlays their fronts. If they differ only in their seeds, summary.csv has
    the median and quartiles of each indicator.
    """

    runs: Annotated[tuple[str, ...], Positional, arg(metavar="RUN ...", help_behavior_hint="")]
    """Run folders (runs/TASK or latest: the newest run), checkpoint files, or shipped policies; one
    or more."""
    tradeoffs: int | None = None
    """Number of trade-offs: an even grid for two objectives; the corners and fixed random draws for
    more; with another protocol than latched, random draws (None: as in training, or 1024 of these).
    """
    protocol: Protocol | None = None
    """How returns are counted (docs/evaluation.md). latched: up to and including the first failed
    step; paper: as in the paper's tables; discounted: as in the tables of C-MORL and D3PO (None: as
    in training)."""
    device: Device = None
    backend: str | None = None
    """Simulator: warp or mujoco (None: chosen by device)."""
    seed: int = 0
    """Random seed of the worlds."""
    seeds: int | None = None
    """Episodes per trade-off, to average over; for tasks with random starts, models or commands
    (None: as in training)."""
    reference: str | None = None
    """Reference front of IGD+: a front.npz or a run (None: the best points of all runs, if there
    are several)."""
    output: Path | None = None
    """Output folder (None: the run's folder, or evaluations/<time> for several runs, a shipped
    policy, a checkpoint other than best.pt, or another protocol than training's)."""


def command(arguments: Sequence[str]) -> None:
    options = dict(parse(Evaluate, arguments))
    if not options["runs"]:
        raise MorlaxError("name at least one run: its folder, such as runs/ant/..., or a file.")
    with cli.Live():
        from ..reports.evaluating import evaluate_runs  # imports torch
        from ..viewers.filming.recording import portrait

        runs, line = options.pop("runs"), typed("evaluate", *arguments)
        _, folder = evaluate_runs(runs, line, portrait=portrait, show=cli.console.print, **options)
    cli.console.print(f"written: {folder}/report.html, indicators.csv, fronts and figures")
