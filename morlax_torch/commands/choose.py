"""Choose a trade-off by what its policy must reach."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import Field, PositiveFloat
from rich.table import Column, Table

from ..envs import MorlaxError
from ..host.files import make_folder, write_file
from .terminal import cli
from .terminal.arguments import Device, Limits, OfRun, arg, parse


class Choose(OfRun, Limits):
    """Find the trade-off that maximizes one value while others keep requirements.

    A value is the return of an objective, counted as in training's evaluations, or a quantity that
    they measure, such as "power (W)"; "power" is enough. The command simulates trade-offs of the
    run's front and others between them, and prints the best that keeps every requirement in
    simulation. For a robot of mjlab on a CPU, it simulates nothing and takes the front's best,
    unless --over-time asks for more.
    """

    maximize: Annotated[str, arg(metavar="NAME")]
    """The objective or quantity to maximize."""
    margin: float | None = None
    """Share of a value's range on the front by which its requirement must be exceeded (None: 0.02
    for tasks with random starts, models or commands, otherwise 0)."""
    seeds: int | None = None
    """Episodes per trade-off, to average over; for such tasks (None: as in training, but at least
    8)."""
    seed: int = 0
    """Random seed of the worlds."""
    bookmark: Annotated[str | None, arg(metavar="NAME")] = None
    """Store the trade-off in the run under this name, for --tradeoff @NAME."""
    card: Annotated[Path | None, arg(metavar="FILE.html")] = None
    """Write a decision card: the requirement, the choice, its returns under pushes and with other
    friction, masses and motors, a film strip, and commands."""
    over_time: bool = False
    """Find a trade-off that changes within an episode, and write it for --tradeoff of record,
    explore and play. A requirement may hold for a window of time: "run=500 @ 3-5" for seconds 3 to
    5. Robots of mjlab need a GPU, or hours."""
    knots: int = Field(default=8, ge=2)
    """Points in time of a trade-off over time, linear in between; more if its windows need more."""
    slew: PositiveFloat = 2.0
    """Largest change of a weight over time, per second."""
    output: Annotated[Path | None, arg(metavar="FILE.yaml")] = None
    """File of a trade-off over time (None: tradeoff_over_time.yaml in the run's folder, or here for
    a shipped policy)."""
    device: Device = None


def command(arguments: Sequence[str]) -> None:
    options = parse(Choose, arguments)
    least, most = options.limits()
    if options.card is not None and options.card.suffix != ".html":
        raise MorlaxError(f"the decision card {options.card} must end in .html.")
    if options.output is not None and options.output.suffix != ".yaml":
        raise MorlaxError(f"the trade-off over time {options.output} must end in .yaml.")
    for name in ("knots", "slew", "output"):
        if not options.over_time and getattr(options, name) != Choose.model_fields[name].default:
            raise MorlaxError(f"--{name} is for a trade-off over time: add --over-time.")
    if options.over_time:
        _over_time(options, least, most)
        return
    if any("@" in name for name in (*least, *most, options.maximize)):
        raise MorlaxError("a requirement for a window of time, such as @ 3-5, needs --over-time.")
    with cli.Live():
        from ..envs.making import has_robot
        from ..evaluation.requirements import shown
        from ..runs import loading
        from ..runs.choosing import Chooser

        if options.bookmark is not None:
            loading.check_bookmark(options.run, options.bookmark)
        policy = loading.load(options.run, options.device, trust=options.trust, env=options.env)
        front = loading.load_front(options.run)
        chooser = Chooser(policy, front, options.seeds, options.seed)
        if options.card is not None:
            make_folder(options.card.parent)  # a mistake is told before the simulation
        choice = chooser.choose(least, options.maximize, most, options.margin)
    kinds = ("promised", "simulated") if choice.simulated else ("evaluated",)
    numbers = (Column(head, justify="right") for head in (*kinds, "required", "margin"))
    table = Table("value", *numbers, box=None)
    for name, promised, *cells in choice.rows(".5g"):
        table.add_row(name, *([promised] if choice.simulated else []), *cells)
    for part in (table, *choice.remarks()):
        cli.console.print(part)
    weights = shown(choice.tradeoff)
    how = f"{choice.simulated} that were simulated" if choice.simulated else "those evaluated"
    cli.console.print(f"trade-off: {weights} (best of {how})")
    if options.bookmark is not None:
        file = loading.bookmark(options.run, options.bookmark, choice.tradeoff)
        cli.console.print(f"written: {file}", soft_wrap=True)
        weights = f"@{options.bookmark}"
    cli.console.print(f"checkpoint: {loading.find_checkpoint(options.run)}", soft_wrap=True)
    commands = {"to evaluate the run": options.use("evaluate")}
    if has_robot(policy.config.env):
        commands = {
            "to export the policy": options.use("export", "--tradeoff", weights),
            "to see the robot": options.use("explore"),
        }
    if options.card is not None:
        with cli.Live():
            from ..reports.page import card
            from ..viewers.filming.recording import strip

            typed = list(commands.values())
            page = card(options.run, policy, choice, typed, strip, options.seed)
            write_file(options.card, page.encode())
        cli.console.print(f"written: {options.card}", soft_wrap=True)
    for purpose, typed in commands.items():
        cli.print_command(purpose, typed)


def _over_time(options: Choose, least: dict[str, float], most: dict[str, float]) -> None:
    """Find, print and write a trade-off over time."""
    if options.card or options.bookmark:
        raise MorlaxError("--card and --bookmark keep one trade-off: leave --over-time out.")
    with cli.Live():
        from ..runs import loading
        from ..tuning.schedules import Scheduler

        policy = loading.load(options.run, options.device, trust=options.trust, env=options.env)
        front = loading.load_front(options.run)
        folder = loading.own_folder(options.run) or Path()
        file = options.output or folder / "tradeoff_over_time.yaml"
        search = options.knots, options.slew, options.margin, options.seeds, options.seed
        scheduler = Scheduler(policy, least, options.maximize, most, *search)
        make_folder(file.parent)  # a mistake is told before minutes of simulation
        schedule, best = scheduler.search(front)
        schedule.save(file, policy.objectives)
    required = scheduler.required
    heads = (Column(head, justify="right") for head in ("required", *best))
    table = Table("value", *heads, box=None)
    for index in required.used:
        levels = [limit.shown(".5g") for limit in required.limits if limit.index == index]
        values = (f"{column.values[0, index]:.5g}" for column in best.values())
        table.add_row(required.names[index], " and ".join(levels), *values)
    table.add_row("falls", "", *(f"{column.falls[0]:.0%}" for column in best.values()))
    kept = ("yes" if required.kept(column.values)[0] else "no" for column in best.values())
    table.add_row("keeps the requirements", "", *kept)
    cli.console.print(table)
    cli.console.print(f"written: {file}", soft_wrap=True)
    cli.print_command("to see the robot", options.use("record", "--tradeoff", str(file)))
