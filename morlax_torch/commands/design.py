"""Find the body of a robot, and the trade-off, that serve best."""

import csv
import io
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, NonNegativeInt

from ..envs import MorlaxError
from ..host.files import make_folder, write_file
from .terminal import cli
from .terminal.arguments import (
    Device,
    Limits,
    OfRun,
    arg,
    parse,
)
from .terminal.live import Live
from .terminal.process import program

FILES = "designs.csv", "designs.png", "designs.pdf", "body.xml", "body.pt"

if TYPE_CHECKING:
    import numpy as np

    from ..tuning.designs import Designer, Simulated


class Design(OfRun, Limits):
    """Search over bodies and trade-offs of a run that was trained with many bodies.

    Simulates bodies spread evenly over the design space, each under the same trade-offs, then
    improves their common front by NSGA-II. Writes that front as a table and a figure, and one body
    as MJCF (body.xml) and as a checkpoint (body.pt) that every command accepts as a run: the body
    of the policy that keeps the requirements and has most of --maximize, or the body whose own
    front has the largest hypervolume.
    """

    maximize: Annotated[str | None, arg(metavar="NAME")] = None
    """The objective or quantity to maximize."""
    bodies: int = Field(default=256, ge=2)
    """Number of bodies to begin with, the default one among them."""
    tradeoffs: int = 16
    """Number of trade-offs of each."""
    rounds: NonNegativeInt = 8
    """Generations of NSGA-II (0: none)."""
    population: int = Field(default=128, ge=2)
    """Policies of a generation."""
    seed: int = 0
    """Random seed of the search, and of the worlds if the task is random."""
    output: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder to write to (None: "designs" in the run's folder, or here for a shipped one)."""
    device: Device = None


def command(arguments: Sequence[str]) -> None:
    options = parse(Design, arguments)
    least, most = options.limits()
    if options.maximize is None and (least or most):
        raise MorlaxError("name what to maximize under these requirements: --maximize NAME.")
    import numpy as np  # takes a while, like torch

    with Live():
        from ..envs import resolve_device
        from ..runs.loading import load, own_folder
        from ..tuning.designs import Designer

        policy = load(
            options.run, resolve_device(options.device), trust=options.trust, env=options.env
        )
        designer = Designer(policy, options.seed)
        folder = options.output or (own_folder(options.run) or Path()) / "designs"
        make_folder(folder)
        grid = designer.grid(options.bodies, options.tradeoffs, options.seed)
        every = grid.joined(designer.refine(grid, options.rounds, options.population, options.seed))
        best, volume = designer.best_body(grid, options.tradeoffs)
        chosen = None
        if options.maximize is not None:
            chosen = designer.choose(every, least, most, options.maximize)
            best = every.designs[chosen]
    _show(designer, grid, every, options.tradeoffs, volume)
    if chosen is None:
        cli.console.print(f"body with the largest hypervolume: {_named(designer, best)}")
    else:
        weights = ",".join(f"{weight:.5g}" for weight in every.tradeoffs[chosen])
        cli.console.print(f"body: {_named(designer, best)}")
        cli.console.print(f"trade-off: {weights} ({_values(designer, every.values[chosen])})")
    _write(designer, every, best, folder, grid.rows(np.arange(options.tradeoffs)).returns)
    cli.console.print(f"written: {folder}: {', '.join(FILES)}", soft_wrap=True)
    body = shlex.quote(str(folder / "body.pt")) + (" --trust" if options.trust else "")
    cli.print_command("to see the robot", f"{program('explore')} {body}")


def _show(
    designer: "Designer", grid: "Simulated", every: "Simulated", tradeoffs: int, best: float
) -> None:
    """Print the fronts of one body and of all, and the most of each objective."""
    import numpy as np
    from rich.table import Table  # takes a while to import

    from ..evaluation import pareto

    without = int(np.isnan(grid.returns).any(1).sum()) // tradeoffs
    missing = f"; {without} bodies could not start" if without else ""
    cli.console.print(f"{len(every.values):,} policies were simulated{missing}")
    table = Table(box=None)
    for column in ("front", "hypervolume", "policies", "bodies"):
        table.add_column(column, justify="left" if column == "front" else "right")
    parts = {"default body": grid.rows(np.arange(tradeoffs)), "bodies spread evenly": grid}
    if len(every.values) > len(grid.values):
        parts["and refined"] = every
    for name, part in parts.items():
        on_front = part.rows(pareto.non_dominated(part.returns))
        number = len(np.unique(on_front.designs, axis=0))
        volume = designer.hypervolume(part)
        table.add_row(name, f"{volume:.4e}", str(len(on_front.values)), str(number))
        if name == "default body":
            table.add_row("best other body", f"{best:.4e}", "", "1")
    cli.console.print(table)
    for index, name in enumerate(designer.policy.objectives):
        row = int(np.nanargmax(every.returns[:, index]))
        text = f"most {name}: {_values(designer, every.values[row])}; "
        cli.console.print(text + _named(designer, every.designs[row]))


def _named(designer: "Designer", design: "np.ndarray") -> str:
    parameters = designer.space.parameters.items()
    return ", ".join(
        f"{name} {value:.3g} {each.unit}"
        for (name, each), value in zip(parameters, design, strict=True)
    )


def _values(designer: "Designer", values: "np.ndarray") -> str:
    names = (*designer.policy.objectives, *designer.quantities)
    return ", ".join(f"{name} {value:.4g}" for name, value in zip(names, values, strict=True))


def _write(
    designer: "Designer",
    every: "Simulated",
    best: "np.ndarray",
    folder: Path,
    usual: "np.ndarray",
) -> None:
    """Write the front of all bodies as a table and a figure, and the best body."""
    from ..envs import get
    from ..envs.worlds.design_space import mjcf
    from ..evaluation import pareto
    from ..evaluation.figures import designs_figure
    from ..evaluation.figures import save as save_figure
    from ..runs.loading import save
    from ..runs.references import copy_files

    names = [f"weight of {name}" for name in designer.policy.objectives]
    values = (*designer.policy.objectives, *designer.quantities)
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*designer.space.parameters, *names, *values])
    front = every.rows(pareto.non_dominated(every.returns))
    for row in zip(*front, strict=True):
        writer.writerow([f"{number:.6g}" for part in row for number in part])
    parameters = [f"{name} ({own.unit})" for name, own in designer.space.parameters.items()]
    usual = pareto.front(usual)
    figure = designs_figure(
        designer.policy.objectives, front.returns, front.designs, parameters, usual
    )
    save_figure(figure, folder / "designs")
    design = designer.space.named(best)
    write_file(folder / "designs.csv", table.getvalue())
    write_file(folder / "body.xml", mjcf(get(designer.policy.config.env), design))
    save(designer.policy.for_design(design).cpu(), folder / "body.pt")
    copy_files(designer.policy.config, folder)
