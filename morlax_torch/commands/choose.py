"""Choose a trade-off by what its policy must reach."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..envs import MorlaxError
from ..host.files import write_file
from .terminal import cli
from .terminal.arguments import (
    Device,
    Limits,
    OfRun,
    Texts,
    arg,
    parse,
)
from .terminal.live import Live

if TYPE_CHECKING:
    from ..evaluation.requirements import Choice, Requirements
    from ..networks.policy import Policy


class Choose(OfRun, Limits):
    """Find the trade-off that maximizes one value while others keep requirements.

    A value is the return of an objective, counted as in training's evaluations, or a quantity that
    they measure, such as "power (W)"; "power" is enough. The command simulates trade-offs of the
    run's front and others between them, and prints the best that keeps every requirement in
    simulation. For a robot of mjlab on a CPU, it simulates nothing and takes the front's best.
    """

    maximize: Annotated[str, arg(metavar="NAME")]
    """The objective or quantity to maximize."""
    constrain: Annotated[Texts, arg(metavar="'run >= 2000'")] = ()
    """The same as 'run >= 2000' or 'power <= 60', which a shell needs in quotes."""
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
    device: Device = None


def command(arguments: Sequence[str]) -> None:
    options = parse(Choose, arguments)
    least, most = options.limits(options.constrain)
    with Live():
        from ..envs.devices import resolve_device
        from ..envs.making import has_robot
        from ..evaluation.requirements import Requirements, shown
        from ..runs import loading
        from ..runs.choosing import chooser
        from ..runs.loading import find_checkpoint, load, load_front, trust_run

        trust_run(options.run, options.trust, options.env)
        if options.bookmark is not None:
            loading.check_bookmark(options.run, options.bookmark)
        if options.card is not None and options.card.suffix != ".html":
            raise MorlaxError(f"the decision card {options.card} must end in .html.")
        policy = load(options.run, resolve_device(options.device), trust=options.trust)
        choosing = chooser(policy, load_front(options.run), options.seeds, options.seed)
        choice = choosing.choose(least, options.maximize, most, options.margin)
        required = Requirements.of(choice.names, least, most, options.maximize)
    _show(choice, required)
    weights = shown(choice.tradeoff)
    how = f"{choice.simulated} that were simulated" if choice.simulated else "those evaluated"
    cli.console.print(f"trade-off: {weights} (best of {how})")
    if options.bookmark is not None:
        file = loading.bookmark(options.run, options.bookmark, choice.tradeoff)
        cli.console.print(f"written: {file}", soft_wrap=True)
        weights = shlex.quote(f"@{options.bookmark}")
    cli.console.print(f"checkpoint: {find_checkpoint(options.run)}", soft_wrap=True)
    commands = {"to evaluate the run": options.use("evaluate")}
    if has_robot(policy.config.env):
        commands = {
            "to export the policy": options.use("export", f" --tradeoff {weights}"),
            "to see the robot": options.use("explore"),
        }
    if options.card is not None:
        with Live():
            page = _card(
                options.run, policy, choice, required, options.seed, list(commands.values())
            )
            write_file(options.card, page.encode())
        cli.console.print(f"written: {options.card}", soft_wrap=True)
    for purpose, typed in commands.items():
        cli.print_command(purpose, typed)


def _card(
    run: str,
    policy: "Policy",
    choice: "Choice",
    required: "Requirements",
    seed: int,
    commands: Sequence[str],
) -> str:
    """Simulate the choice under other conditions, and describe it."""
    from ..envs.making import has_robot
    from ..envs.naming import title
    from ..host.version import __version__
    from ..reports.card import card
    from ..runs.checkpoint import fingerprint
    from ..runs.loading import find_checkpoint
    from ..runs.trials import trials
    from ..viewers.filming.recording import strip

    tried = trials(policy, choice.tradeoff, seed)
    about = {
        "run": run,
        "checkpoint": str(find_checkpoint(run)),
        "fingerprint of the policies": fingerprint(policy.agent.state_dict()),
        "morlax-torch": __version__,
    }
    env = policy.config.env
    picture = strip(policy.cpu(), choice.tradeoff) if has_robot(env) else None
    return card(title(env), choice, required, tried, about, commands, picture)


def _show(choice: "Choice", required: "Requirements") -> None:
    """Print promised and simulated, or evaluated values, margins and the cost."""
    from rich.table import Table  # takes a while to import

    table = Table(box=None)
    kinds = ("promised", "simulated") if choice.simulated else ("evaluated",)
    for column in ("value", *kinds, "required", "margin"):
        table.add_column(column, justify="left" if column == "value" else "right")
    for index in required.used:
        name = required.names.all[index]
        promised = f"{choice.promised[name]:.5g}" if name in choice.promised else ""
        told = [promised, f"{choice.values[index]:.5g}"][-len(kinds) :]
        limits = [limit.shown() for limit in required.limits if limit.index == index]
        margin = [f"{choice.margins[name]:+.4g}"] if limits else []
        table.add_row(name, *told, " and ".join(limits), *margin)
    cli.console.print(table)
    if required.limits:
        best = choice.values[required.maximized] + choice.cost
        cli.console.print(
            f"cost of the requirements: {choice.cost:.4g} of "
            f"{required.names.all[required.maximized]}, which reaches {best:.5g} without them"
        )
    if choice.falls:
        broken = ", which breaks every requirement" if required.limits else ""
        cli.console.print(f"falls: in {choice.falls:.0%} of its episodes{broken}")
