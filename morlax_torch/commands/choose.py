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
from .terminal.task_arguments import (
    Device,
    Moved,
    RunName,
    Trust,
    call,
)

if TYPE_CHECKING:
    from ..evaluation.requirements import Choice, Requirements
    from ..networks.policy import Policy


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
        with Live():
            from ..envs.devices import resolve_device
            from ..evaluation.requirements import Requirements, shown
            from ..runs import bookmarks
            from ..runs.choosing import chooser
            from ..runs.fronts import load_front
            from ..runs.loading import find_checkpoint, load, trust_run

            trust_run(run, trust, env)
            if bookmark is not None:
                bookmarks.check_bookmark(run, bookmark)
            if card is not None and card.suffix != ".html":
                raise MorlaxError(f"the decision card {card} must end in .html.")
            policy = load(run, resolve_device(device), trust=trust)
            choosing = chooser(policy, load_front(run), seeds, seed)
            choice = choosing.choose(least, maximize, most, margin)
            required = Requirements.of(choice.names, least, most, maximize)
        _show(choice, required)
        weights = shown(choice.tradeoff)
        how = f"{choice.simulated} that were simulated" if choice.simulated else "those evaluated"
        cli.console.print(f"trade-off: {weights} (best of {how})")
        if bookmark is not None:
            file = bookmarks.bookmark(run, bookmark, choice.tradeoff)
            cli.console.print(f"written: {file}", soft_wrap=True)
            weights = shlex.quote(f"{bookmarks.SIGN}{bookmark}")
        cli.console.print(f"checkpoint: {find_checkpoint(run)}", soft_wrap=True)
        commands = _commands(run, weights, trust, env, policy.config.env)
        if card is not None:
            with Live():
                page = _card(run, policy, choice, required, seed, list(commands.values()))
                write_file(card, page.encode())
            cli.console.print(f"written: {card}", soft_wrap=True)
        for purpose, typed in commands.items():
            cli.print_command(purpose, typed)

    call(main, arguments, program("choose"))


def _commands(run: str, weights: str, trust: bool, moved: str | None, task: str) -> dict[str, str]:
    """Return the command lines that use the policy, by their purpose."""
    from ..envs.making import has_robot

    named = shlex.quote(run) + (" --trust" if trust else "")
    if moved is not None:
        named += f" --env {shlex.quote(moved)}"
    if not has_robot(task):
        return {"to evaluate the run": f"{program('evaluate')} {named}"}
    return {
        "to export the policy": f"{program('export')} {named} --tradeoff {weights}",
        "to see the robot": f"{program('explore')} {named}",
    }


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
