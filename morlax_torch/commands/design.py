"""Find the best body of a robot, and the best trade-off."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field, NonNegativeInt
from rich.table import Table

from ..envs import MorlaxError
from ..host.files import make_folder
from .terminal import cli
from .terminal.arguments import Device, Limits, OfRun, arg, parse
from .terminal.process import typed

FILES = "designs.csv", "designs.png", "designs.pdf", "body.xml", "body.pt"


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
        if options.maximize is not None:  # mistakes are told before minutes of simulation
            names = policy.objectives, designer.quantities
            required = Requirements.of(*names, least, options.maximize, most)
        folder = options.output or (own_folder(options.run) or Path()) / "designs"
        make_folder(folder)
        grid = designer.grid(options.bodies, options.tradeoffs)
        simulated = grid.joined(designer.refine(grid, options.rounds, options.population))
        best, volume = designer.best_body(grid, options.tradeoffs)
    default = grid.rows(slice(options.tradeoffs))
    without = grid.missing // options.tradeoffs
    missing = f"; {without} bodies could not start" if without else ""
    cli.console.print(f"{len(simulated.values):,} policies were simulated{missing}")
    table = Table("front", "hypervolume", "policies", "bodies", box=None)
    for cells in designer.compared(default, grid, simulated, volume):
        table.add_row(*cells)
    for part in (table, *designer.extremes(simulated)):
        cli.console.print(part)
    verdict = [f"body with the largest hypervolume: {designer.body(best)}"]
    if options.maximize is not None:
        try:
            row = int(required.ranked(simulated.tradeoffs, simulated.values, "simulated")[0])
        except MorlaxError:
            designer.write(folder, simulated, default, best)  # the front took minutes
            cli.console.print(f"{verdict[0]}\nwritten: {folder}", soft_wrap=True)
            raise
        best = simulated.designs[row]
        weights, reached = shown(simulated.tradeoffs[row]), designer.reached(simulated, row)
        verdict = [f"body: {designer.body(best)}", f"trade-off: {weights} ({reached})"]
    for line in verdict:
        cli.console.print(line)
    designer.write(folder, simulated, default, best)
    cli.console.print(f"written: {folder}: {', '.join(FILES)}", soft_wrap=True)
    trust = ["--trust"] * options.trust
    cli.print_command("to see the robot", typed("explore", folder / "body.pt", *trust))
