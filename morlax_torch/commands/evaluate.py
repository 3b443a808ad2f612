"""Evaluate trained runs: fronts, indicators, figures and a report."""

import copy
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..configuration.sections import Protocol
from ..envs import MorlaxError
from ..host.phases import phase
from .terminal import cli
from .terminal.live import Live
from .terminal.startup import program
from .terminal.task_arguments import (
    Device,
    Moved,
    Trust,
    call,
)

PORTRAIT_SECONDS = 1.0  # simulated time at which the report shows the robot

if TYPE_CHECKING:
    from ..networks.policy import Policy
    from ..reports.comparison import Evaluated


def command(arguments: Sequence[str]) -> None:
    def main(
        runs: Annotated[
            tuple[str, ...],
            tyro.conf.Positional,
            tyro.conf.arg(metavar="RUN", help_behavior_hint="(one or more)"),
        ],
        tradeoffs: int | None = None,
        protocol: Protocol | None = None,
        device: Device = None,
        backend: str | None = None,
        seed: int = 0,
        seeds: int | None = None,
        reference: str | None = None,
        output: Path | None = None,
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Evaluate the policies of many trade-offs and print the indicators.

        Says how good the front is and what to do next. Writes each run's front (front.npz,
        front.csv), figures (png and pdf), indicators.csv and report.html, a self-contained file.
        Several runs are compared: one figure overlays their fronts, and summary.csv has the median
        and quartiles of each indicator.

        Args:
            runs: Run folders (runs/TASK or latest: the newest run), checkpoint files, or shipped
                policies.
            tradeoffs: Number of trade-offs: an even grid for two objectives; the corners and fixed
                random draws for more (None: as in training, or the 1024 random draws of another
                protocol).
            protocol: How returns are counted (None: as in training). latched: up to and including
                the first failed step. paper: as in the paper's tables, which draw trade-offs at
                random; failed steps earn no reward, and the reward of the reset is added.
                discounted: as C-MORL and D3PO on MO-Gymnasium's tasks, by 0.99 per step, over at
                most 500 steps; the reference point is -100 in every objective.
            backend: Simulator: warp or mujoco (None: chosen by device).
            seed: Random seed of the worlds.
            seeds: Episodes per trade-off, to average over; for tasks with random starts, models or
                commands (None: as in training).
            reference: Reference front of IGD+: a front.npz or a run (None: the best points of all
                runs, if there are several).
            output: Output folder (None: the run's folder, or evaluations/<time> for several runs,
                a shipped policy, a checkpoint other than best.pt, or another protocol than
                training's).
        """
        if not runs:
            raise MorlaxError(
                "name at least one run: its folder, such as runs/ant/..., or a .pt file."
            )
        typed = f"{program('evaluate')} {shlex.join(arguments)}"
        with Live():
            from ..reports.evaluating import column_heads, evaluate_runs, table  # imports torch
            from ..reports.verdict import verdict_of

            def show(found: "Mapping[str, Evaluated]") -> None:
                cli.console.print(verdict_of(found), markup=False, highlight=False)
                cli.console.print(table(found))
                heads = column_heads(list(found))
                names = [
                    f"{run.front.checkpoint} of {name}" + f" ({head})" * (head != name)
                    for head, (name, run) in zip(heads, found.items(), strict=True)
                ]
                cli.console.print(f"evaluated: {', '.join(names)}")

            _, folder = evaluate_runs(
                runs,
                typed,
                tradeoffs=tradeoffs,
                protocol=protocol,
                device=device,
                backend=backend,
                seed=seed,
                seeds=seeds,
                reference=reference,
                output=output,
                trust=trust,
                env=env,
                portrait=_portrait,
                show=show,
            )
        cli.console.print(f"written: {folder}/report.html, indicators.csv, fronts and figures")

    call(main, arguments, program("evaluate"))


def _portrait(policy: "Policy") -> bytes | None:
    """Return a picture of the robot under equal weights, if it can be drawn here."""
    from io import BytesIO

    phase("drawing the robot")
    try:
        from PIL import Image

        from ..viewers.filming.film import Film

        equal = [1.0] * len(policy.objectives)
        film = Film(copy.deepcopy(policy).cpu(), [equal], width=640, height=400)
        *_, last = film.frames(PORTRAIT_SECONDS, film.steps(PORTRAIT_SECONDS))
    except (ImportError, MorlaxError):  # an extra, OpenGL or a MuJoCo robot is missing
        return None
    drawn = BytesIO()
    Image.fromarray(last).save(drawn, format="PNG")
    return drawn.getvalue()
