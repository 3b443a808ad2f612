"""Record a trained policy under several trade-offs: MP4, GIF, or a film strip for a paper."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from ..envs import MorlaxError
from .terminal import cli
from .terminal.arguments import OfRun, Texts, arg, numbers, parse


class Record(OfRun):
    """Record the robot under several trade-offs side by side, with its running returns.

    A robot that fails is frozen and dimmed, with the returns of its episode. No display is needed.
    """

    tradeoff: Annotated[Texts, arg(metavar="0.8,0.2")] = ()
    """Weight of each objective, @NAME of a bookmark, or FILE.yaml of a trade-off over time, once
    per panel; weights need not sum to one (None: each objective alone, and the balanced
    trade-off)."""
    body: Annotated[Texts, arg(metavar="thigh=0.4,calf=0.3")] = ()
    """Design parameters of a body, once per body, of a run that was trained with many; each is
    shown under every trade-off (None: the run's own body, or with bodies, the balanced
    trade-off)."""
    output: Path | None = None
    """Output file: FILE.mp4, FILE.gif, or FILE.png for a film strip (None: film.mp4 in the run's
    folder, or NAME.mp4 in the working directory for a shipped policy)."""
    seconds: float | None = None
    """Duration, in seconds of simulated time (None: 5, or 30 of a training). A film strip shows the
    end of it."""
    speed: float = 1.0
    """Playback speed; 0.5 is slow motion. Ignored for a film strip."""
    width: int = 480
    """Width of a panel, in pixels."""
    height: int = 360
    """Height of a panel, in pixels."""
    pictures: int = 8
    """Number of pictures per row of a film strip, at equal steps of time in all rows, over the
    longest gait cycle (two if a cycle has fewer control steps than pictures)."""
    seed: int = 0
    """Random seed of the world."""
    sweep: bool = False
    """Film one robot whose trade-off moves along the front, beside the front."""
    training: bool = False
    """Film how the front and its hypervolume grew in training, beside the trained robot (without
    --tradeoff, under each plotted objective alone)."""


def command(arguments: Sequence[str]) -> None:
    options = parse(Record, arguments)
    with cli.Live():
        from ..runs import loading  # imports torch
        from ..runs.progress import kept_fronts
        from ..viewers.filming.growth import Growth
        from ..viewers.filming.recording import Sweep, record

        run = options.run
        tradeoffs = [loading.moving_tradeoff_of(text, run) for text in options.tradeoff]
        policy = loading.load(run, trust=options.trust, env=options.env)
        folder = loading.own_folder(run)
        usual = folder / "film.mp4" if folder else Path(f"{loading.find_run(run).name}.mp4")
        file = options.output or usual
        example = "--body thigh=0.4,calf=0.3"
        bodies = [dict(numbers(text.split(","), example)) for text in options.body]
        special, seconds = None, options.seconds
        if seconds is None:
            seconds = 30.0 if options.training else 5.0
        if options.sweep and options.training:
            raise MorlaxError("choose --sweep or --training.")
        if options.sweep:
            special = partial(Sweep, policy, loading.load_front(run))
        elif options.training:
            special = partial(Growth, policy, kept_fronts(loading.find_run(run)), tradeoffs)
            tradeoffs = []
        sizes = options.width, options.height, options.pictures
        others = *sizes, options.seed, special, bodies
        record(policy, file, tradeoffs, seconds, options.speed, *others)
    cli.console.print(f"written: {file}")
