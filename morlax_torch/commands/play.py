"""Run an exported policy in C MuJoCo, in real time or in many episodes."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import NonNegativeInt
from rich.table import Column, Table

from ..envs import MorlaxError
from ..envs.worlds.options import Section
from .terminal import cli
from .terminal.arguments import Positional, arg, parse

NOT_IN_TOUR = "episodes", "output", "gamepad", "delay", "noise", "push", "friction", "seed"
Pair = Annotated[tuple[float, float], arg(metavar="LOW HIGH")]


class Play(Section):
    """Run an exported policy in C MuJoCo, without torch: a check before a real robot.

    Without --episodes, a window shows the robot in real time, and keys steer it. Without a display,
    a film is written. Commands are random in films and episodes, and the trade-off slides between
    random points unless one is given. A tour is scored like the public teleop-walking-benchmark
    scores the G1. A policy that follows a motion starts from a stand in its first pose.
    """

    export: Annotated[Path, Positional, arg(metavar="EXPORT")]
    """Folder in which morlax export wrote deploy.yaml, or the policy's .onnx there."""
    episodes: int | None = None
    """Run this many episodes as fast as possible, and print a table of falls, tracking errors and
    power."""
    tour: bool = False
    """Score a policy of mjlab:Mjlab-Tour-Flat-Unitree-G1 by the rules of the public
    teleop-walking-benchmark, and print the columns of its table."""
    tour_runs: int = 256
    """Number of runs of a tour; their random seeds are 0, 1, and so on."""
    tradeoff: Annotated[str | None, arg(metavar="0.7,0.3")] = None
    """Weight of each objective, or FILE.yaml of a trade-off over the time of a motion (None: the
    same for all in a tour and at first in a window, random otherwise)."""
    seconds: float | None = None
    """Duration of an episode or film, or after which the window closes (None: 30 in episodes, 90 in
    a tour, 5 in a film, all of a motion, no limit in a window)."""
    output: Path | None = None
    """Write a film, FILE.mp4 or FILE.gif, instead of opening a window (None: film.mp4 if there is
    no display)."""
    gamepad: Path | None = None
    """Device of a gamepad that steers the robot too, such as /dev/input/js0."""
    delay: Pair = (0.0, 20.0)
    """Range of the delay of actions, in ms, drawn once per episode."""
    noise: float = 1.0
    """Factor on the observation noise of the training."""
    push: float = 0.5
    """Largest push, in m/s along each horizontal axis, every 1 to 3 s."""
    friction: Pair = (0.3, 1.2)
    """Range of the sliding friction, drawn once per episode."""
    seed: NonNegativeInt = 0
    """Random seed of commands, trade-offs and disturbances."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Play, arguments)
    for name in NOT_IN_TOUR if options.tour else ("tour_runs",):
        if getattr(options, name) != Play.model_fields[name].default:
            flag, where = name.replace("_", "-"), "in" if options.tour else "without"
            raise MorlaxError(f"--{flag} has no effect {where} a tour (--tour): leave it out.")
    for name in ("output", "gamepad"):
        if options.episodes is not None and getattr(options, name) is not None:
            raise MorlaxError(f"--{name} has no effect with --episodes: leave one of them out.")
    from ..viewers.playing.episodes import HELP, SLIDING, film, run, show
    from ..viewers.playing.robot import Disturbances, open_export
    from ..viewers.window import has_display

    seconds, seed = options.seconds, options.seed
    strengths = Disturbances(options.delay, options.noise, options.push, options.friction)
    deployment = open_export(options.export, options.tradeoff)._replace(disturbances=strengths)
    follows = deployment.motion is not None
    if options.tour:
        from ..viewers.playing.tour import WALK, score

        if follows:
            raise MorlaxError(f"{options.export} follows a motion, no waypoints: leave --tour out.")
        weights = deployment.tradeoff and deployment.tradeoff.at(0.0).tolist()
        seconds = WALK if seconds is None else seconds
        with cli.Live():
            columns = score(options.export, options.tour_runs, weights, seconds)
        table = Table("column", Column(f"{options.tour_runs} runs", justify="right"))
        for name, value in columns.items():
            table.add_row(name, "-" if math.isnan(value) else f"{value:.1f}")
        cli.console.print(table)
        return
    if options.episodes is not None:
        length = (deployment.duration or 30.0) if seconds is None else seconds
        with cli.Live():
            episodes = run(deployment, options.episodes, length, seed)
        cli.console.print(_table(episodes, follows))
        return
    if options.output is None and has_display():
        cli.console.print(SLIDING if follows else HELP)
        falls = show(deployment, seconds, options.gamepad, seed)
    elif options.gamepad is not None:
        raise MorlaxError("--gamepad steers a robot in a window, not in a film: leave it out.")
    else:
        file = options.output or Path("film.mp4")
        length = (deployment.duration or 5.0) if seconds is None else seconds
        with cli.Live():
            falls = film(deployment, file, length, seed)
        cli.console.print(f"written: {file}")
    cli.console.print(f"falls: {falls}")


def _table(episodes: Sequence, follows: bool) -> Table:
    from ..viewers.playing.episodes import summary

    unit, digits = ("mm", 1) if follows else ("m/s", 3)
    heads = ("episode", "falls", "time, s", f"error, {unit}", "power, W", "cost of transport")
    table = Table(*(Column(head, justify="right") for head in heads))
    rows = [*enumerate(episodes, 1), ("all", summary(episodes))]
    for name, row in rows:
        numbers = f"{row.error:.{digits}f}", f"{row.power:.1f}", f"{row.transport:.2f}"
        table.add_row(str(name), f"{row.falls:.0f}", f"{row.seconds:.1f}", *numbers)
    return table
