"""Record a trained policy under several trade-offs: MP4, GIF, or a film strip for a paper."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from .terminal import cli
from .terminal.live import Live
from .terminal.named_numbers import numbers
from .terminal.startup import program
from .terminal.task_arguments import (
    Moved,
    RunName,
    Trust,
    call,
)


def command(arguments: Sequence[str]) -> None:
    def main(
        run: RunName,
        tradeoff: Annotated[
            tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="0.8,0.2")
        ] = (),
        body: Annotated[
            tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="thigh=0.4,calf=0.3")
        ] = (),
        output: Path | None = None,
        seconds: float = 5.0,
        speed: float = 1.0,
        width: int = 480,
        height: int = 360,
        pictures: int = 8,
        seed: int = 0,
        sweep: bool = False,
        trust: Trust = False,
        env: Moved = None,
    ) -> None:
        """Record the robot under several trade-offs side by side, with its running returns.

        A robot that fails is frozen and dimmed, with the returns of its episode. No display is
        needed.

        Args:
            tradeoff: Weight of each objective, or @NAME of a bookmark, once per panel; weights need
                not sum to one (None: each objective alone, and the balanced trade-off).
            body: Design parameters of a body, once per body, of a run that was trained with many;
                each is shown under every trade-off (None: the run's own body, or with bodies, the
                balanced trade-off).
            output: Output file: FILE.mp4, FILE.gif, or FILE.png for a film strip
                (None: film.mp4 in the run's folder, or NAME.mp4 in the working directory
                for a shipped policy).
            seconds: Duration, in seconds of simulated time. A film strip shows the end of it.
            speed: Playback speed; 0.5 is slow motion. Ignored for a film strip.
            width: Width of a panel, in pixels.
            height: Height of a panel, in pixels.
            pictures: Number of pictures per row of a film strip, evenly spaced over the robot's
                last gait cycle (the last two if a cycle has fewer control steps than pictures).
            seed: Random seed of the world.
            sweep: Film one robot whose trade-off moves along the front, beside the front.
        """
        with Live():
            from ..runs.bookmarks import tradeoff_of
            from ..runs.fronts import load_front
            from ..runs.loading import find_run, load, objectives_of, own_folder  # imports torch
            from ..viewers.filming.recording import record

            objectives = objectives_of(run)
            tradeoffs = [tradeoff_of(text, run, objectives) for text in tradeoff]
            policy = load(run, trust=trust, env=env)
            folder, shipped = own_folder(run), Path(f"{find_run(run).name}.mp4")
            place = output or (folder / "film.mp4" if folder else shipped)
            front = load_front(run) if sweep else None
            bodies = [numbers(text, "--body thigh=0.4,calf=0.3") for text in body]
            sizes = width, height, pictures
            record(policy, place, tradeoffs, seconds, speed, *sizes, seed, front, bodies)
        cli.console.print(f"written: {place}")

    call(main, arguments, program("record"))
