"""Choose a trade-off by what its policy must reach."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..envs import MorlaxError
from ..host.files import write_file
from .terminal import cli
from .terminal.live import Live
from .terminal.named_numbers import AtLeast, AtMost, limits
from .terminal.startup import program
from .terminal.task_arguments import Device, Moved, RunName, Trust, call

if TYPE_CHECKING:
    from ..evaluation.requirements import Choice


def command(arguments: Sequence[str]) -> None:
    def main(
        run: RunName,
        maximize: Annotated[str, tyro.conf.arg(metavar="NAME")],
        at_least: AtLeast = (),
        at_most: AtMost = (),
        constrain: Annotated[
            tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="'run >= 2000'")
        ] = (),
        margin: float | None = None,
        seeds: int | None = None,
        seed: int = 0,
        bookmark: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
        card: Annotated[Path | None, tyro.conf.arg(metavar="FILE.html")] = None,
        device: Device = None,
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Find the trade-off that maximizes one value while others keep requirements.

        A value is the return of an objective, counted as in training's evaluations, or a quantity
        that they measure, such as "power (W)"; "power" is enough. The command simulates trade-offs
        of the run's front and others between them, and prints the best that keeps every requirement
        in simulation. For a robot of mjlab on a CPU, it simulates nothing and takes the front's
        best.

        Args:
            maximize: The objective or quantity to maximize.
            at_least: Least value of an objective or quantity, once per requirement.
            at_most: Largest value of an objective or quantity, once per requirement.
            constrain: The same as 'run >= 2000' or 'power <= 60', which a shell needs in quotes.
            margin: Share of a value's range on the front by which its requirement must be
                exceeded (None: 0.02 for tasks with random starts, models or commands, otherwise 0).
            seeds: Episodes per trade-off, to average over; for such tasks (None: as in training,
                but at least 8).
            seed: Random seed of the worlds.
            bookmark: Store the trade-off in the run under this name, for --tradeoff @NAME.
            card: Write a decision card: the requirement, the choice, its returns under pushes and
                with other friction, masses and motors, a film strip, and commands.
        """
        least, most = limits(at_least, at_most, constrain)
        if card is not None and card.suffix != ".html":
            raise MorlaxError(f"the decision card {card} must end in .html.")
        with Live():
            from ..envs.making import has_robot
            from ..evaluation.requirements import shown
            from ..runs import loading
            from ..runs.choosing import Chooser, trials
            from ..runs.loading import find_checkpoint, load, load_front

            if bookmark is not None:
                loading.check_bookmark(run, bookmark)
            policy = load(run, device, trust=trust, env=env)
            chooser = Chooser(policy, load_front(run), seeds, seed)
            choice = chooser.choose(least, maximize, most, margin)
        _show(choice)
        weights, checkpoint = shown(choice.tradeoff), find_checkpoint(run)
        how = f"{choice.simulated} that were simulated" if choice.simulated else "those evaluated"
        cli.console.print(f"trade-off: {weights} (best of {how})")
        if bookmark is not None:
            file = loading.bookmark(run, bookmark, choice.tradeoff)
            cli.console.print(f"written: {file}", soft_wrap=True)
            weights = shlex.quote(f"@{bookmark}")
        cli.console.print(f"checkpoint: {checkpoint}", soft_wrap=True)
        words = shlex.quote(run) + (" --trust" if trust else "")
        words += "" if env is None else f" --env {shlex.quote(env)}"
        commands = {"to evaluate the run": f"{program('evaluate')} {words}"}
        if has_robot(policy.config.env):
            commands = {
                "to export the policy": f"{program('export')} {words} --tradeoff {weights}",
                "to see the robot": f"{program('explore')} {words}",
            }
        if card is not None:
            with Live():
                from ..envs.naming import title
                from ..host.version import __version__
                from ..reports import card as cards
                from ..runs.checkpoint import fingerprint
                from ..viewers.filming.recording import strip

                facts = {
                    "run": run,
                    "checkpoint": str(checkpoint),
                    "fingerprint of the policies": fingerprint(policy.agent.state_dict()),
                    "morlax-torch": __version__,
                }
                name, tried = title(policy.config.env), trials(policy, choice.tradeoff, seed)
                robot = has_robot(policy.config.env)
                film = strip(policy.cpu(), choice.tradeoff) if robot else None
                page = cards.card(name, choice, tried, facts, list(commands.values()), film)
                write_file(card, page.encode())
            cli.console.print(f"written: {card}", soft_wrap=True)
        for purpose, typed in commands.items():
            cli.print_command(purpose, typed)

    call(main, arguments, program("choose"))


def _show(choice: "Choice") -> None:
    """Print promised and simulated, or evaluated values, margins and the cost."""
    from rich.table import Table  # takes a while to import

    required, table = choice.required, Table(box=None)
    kinds = ("promised", "simulated") if choice.simulated else ("evaluated",)
    for column in ("value", *kinds, "required", "margin"):
        table.add_column(column, justify="left" if column == "value" else "right")
    for index in required.used:
        name = required.names[index]
        promised = f"{choice.promised[name]:.5g}" if name in choice.promised else ""
        values = [promised, f"{choice.values[index]:.5g}"][-len(kinds) :]
        limits = [limit.shown() for limit in required.limits if limit.index == index]
        margin = f"{choice.margins[name]:+.4g}" if limits else ""
        table.add_row(name, *values, " and ".join(limits), margin)
    cli.console.print(table)
    if required.limits:
        best = choice.values[required.maximized] + choice.cost
        cli.console.print(
            f"cost of the requirements: {choice.cost:.4g} of "
            f"{required.names[required.maximized]}, which reaches {best:.5g} without them"
        )
    if choice.falls:
        broken = ", which breaks every requirement" if required.limits else ""
        cli.console.print(f"falls: in {choice.falls:.0%} of its episodes{broken}")
