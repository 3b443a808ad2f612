"""Run an exported policy in C MuJoCo, in real time or in many episodes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Column, Table

from .terminal import cli
from .terminal.live import Live
from .terminal.startup import program
from .terminal.task_arguments import call

Pair = tuple[float, float]


def command(arguments: Sequence[str]) -> None:
    def main(
        export: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="EXPORT")],
        episodes: int | None = None,
        seconds: float | None = None,
        output: Path | None = None,
        gamepad: Path | None = None,
        delay: Annotated[Pair, tyro.conf.arg(metavar="LOW HIGH")] = (0.0, 20.0),
        noise: float = 1.0,
        push: float = 0.5,
        friction: Annotated[Pair, tyro.conf.arg(metavar="LOW HIGH")] = (0.3, 1.2),
        seed: int = 0,
    ) -> None:
        """Run an exported policy in C MuJoCo, without torch: a check before a real robot.

        Without --episodes, a window shows the robot in real time, and keys steer it. Without a
        display, a film is written. Commands are random in films and episodes, and the
        trade-off slides between random points.

        Args:
            export: Folder in which morlax export wrote deploy.yaml, or the policy's .onnx there.
            episodes: Run so many episodes as fast as possible, and print a table of falls,
                tracking errors and power.
            seconds: Duration of an episode or film, or after which the window closes (None: 30
                in episodes, 5 in a film, no limit in a window).
            output: Write a film, FILE.mp4 or FILE.gif, instead of opening a window (None:
                film.mp4 if there is no display).
            gamepad: Device of a gamepad that steers the robot too, such as /dev/input/js0.
            delay: Range of the delay of actions, in ms, drawn once per episode.
            noise: Factor on the observation noise of the training.
            push: Largest push, in m/s along each horizontal axis, every 1 to 3 s.
            friction: Range of the sliding friction, drawn once per episode.
            seed: Random seed of commands, trade-offs and disturbances.
        """
        from ..viewers.playing.deployment import open_export  # imports MuJoCo
        from ..viewers.playing.disturbances import Disturbances
        from ..viewers.playing.episodes import run
        from ..viewers.playing.showing import film, has_display, show
        from ..viewers.playing.steering import HELP

        strengths, deployment = Disturbances(delay, noise, push, friction), open_export(export)
        if episodes is not None:
            with Live():
                found = run(
                    deployment, strengths, episodes, 30.0 if seconds is None else seconds, seed
                )
            cli.console.print(_table(found))
            return
        if output is None and has_display():
            cli.console.print(HELP)
            falls = show(deployment, strengths, seconds, gamepad, seed)
        else:
            place = output or Path("film.mp4")
            with Live():
                falls = film(
                    deployment, strengths, place, 5.0 if seconds is None else seconds, seed
                )
            cli.console.print(f"written: {place}")
        cli.console.print(f"falls: {falls}")

    call(main, arguments, program("play"))


def _table(episodes: Sequence) -> Table:
    from ..viewers.playing.episodes import summary

    heads = ("episode", "falls", "time, s", "error, m/s", "power, W", "cost of transport")
    table = Table(*(Column(head, justify="right") for head in heads))
    rows = [*enumerate(episodes, 1), ("all", summary(episodes))]
    for name, row in rows:
        numbers = f"{row.error:.3f}", f"{row.power:.1f}", f"{row.transport:.2f}"
        table.add_row(str(name), f"{row.falls:.0f}", f"{row.seconds:.1f}", *numbers)
    return table
