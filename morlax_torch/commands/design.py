"""Find the best body of a robot, and the best trade-off."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, NonNegativeInt

from ..envs import MorlaxError
from ..host.files import make_folder
from .terminal import cli
from .terminal.arguments import Device, Limits, OfRun, arg, parse
from .terminal.process import typed

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

    with cli.Live():
        from ..envs import resolve_device
        from ..evaluation.requirements import Requirements, shown
        from ..runs.loading import load, own_folder
        from ..tuning.designs import Designer

        device = resolve_device(options.device)
        policy = load(options.run, device, trust=options.trust, env=options.env)
        designer = Designer(policy, options.seed)
        folder = options.output or (own_folder(options.run) or Path()) / "designs"
        make_folder(folder)
        grid = designer.grid(options.bodies, options.tradeoffs, options.seed)
        refined = designer.refine(grid, options.rounds, options.population, options.seed)
        simulated = grid.joined(refined)
        best, volume = designer.best_body(grid, options.tradeoffs)
        told = [f"body with the largest hypervolume: {_body(designer, best)}"]
        if options.maximize is not None:
            names = policy.objectives, designer.quantities
            required = Requirements.of(*names, least, options.maximize, most)
            ranked = required.ranked(simulated.tradeoffs, simulated.values, "simulated")
            row = int(ranked[0])
            best = simulated.designs[row]
            weights, reached = shown(simulated.tradeoffs[row]), _reached(designer, simulated, row)
            told = [f"body: {_body(designer, best)}", f"trade-off: {weights} ({reached})"]
    default = grid.rows(slice(options.tradeoffs))
    _show(designer, (default, grid, simulated), volume)
    for line in told:
        cli.console.print(line)
    designer.write(folder, simulated, default, best)
    cli.console.print(f"written: {folder}: {', '.join(FILES)}", soft_wrap=True)
    trust = ["--trust"] * options.trust
    cli.print_command("to see the robot", typed("explore", folder / "body.pt", *trust))


def _show(designer: "Designer", parts: "Sequence[Simulated]", best: float) -> None:
    """Print the fronts of one body and of all, and the most of each objective."""
    import numpy as np
    from rich.table import Table  # takes a while to import

    from ..evaluation import pareto

    default, grid, simulated = parts
    without = int(np.isnan(grid.returns).any(1).sum()) // len(default.values)
    missing = f"; {without} bodies could not start" if without else ""
    cli.console.print(f"{len(simulated.values):,} policies were simulated{missing}")
    table = Table("front", "hypervolume", "policies", "bodies", box=None)
    names = "default body", "bodies spread evenly", "and refined"
    for name, part in zip(names, parts, strict=True):
        front = part.rows(pareto.non_dominated(part.returns))
        bodies = len(np.unique(front.designs, axis=0))
        volume = f"{designer.hypervolume(part):.4e}"
        table.add_row(name, volume, str(len(front.values)), str(bodies))
        if part is default:
            table.add_row("best body", f"{best:.4e}", "", "1")
    cli.console.print(table)
    for index, name in enumerate(designer.policy.objectives):
        row = int(np.nanargmax(simulated.returns[:, index]))
        reached = _reached(designer, simulated, row)
        cli.console.print(f"most {name}: {reached}; {_body(designer, simulated.designs[row])}")


def _body(designer: "Designer", design: "np.ndarray") -> str:
    parameters = zip(designer.space.parameters.items(), design, strict=True)
    return ", ".join(f"{name} {value:.3g} {each.unit}" for (name, each), value in parameters)


def _reached(designer: "Designer", simulated: "Simulated", row: int) -> str:
    names = (*designer.policy.objectives, *designer.quantities)
    values = zip(names, simulated.values[row], strict=True)
    return ", ".join(f"{name} {value:.4g}" for name, value in values)
