"""Film a trained policy under several trade-offs: MP4, GIF, or a film strip for a paper."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from .runs.loading import SHIPPED, find_run, load
from .terminal import cli
from .tradeoffs import parse_tradeoff
from .viewers.filming.recording import record


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        tradeoff: Annotated[
            tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="0.8,0.2")
        ] = (),
        output: Path | None = None,
        seconds: float = 5.0,
        speed: float = 1.0,
        width: int = 480,
        height: int = 360,
        pictures: int = 8,
        seed: int = 0,
    ) -> None:
        """Film the robot under several trade-offs side by side, with its returns as they grow.

        A robot that fails stays as it is, dimmed, with what its episode paid. Needs no screen.

        Args:
            run: A run's folder (its best checkpoint), a checkpoint file, or a shipped policy.
            tradeoff: How much each objective matters, once for each panel; they need not sum to
                one (none: the corners, and the balanced one).
            output: FILE.mp4, FILE.gif, or FILE.png for a film strip (None: film.mp4 in the run's
                folder; here for a shipped policy).
            seconds: Of the robot's time.
            speed: Of the film: 0.5 is slow motion. A film strip has none.
            width: Of a panel, in pixels.
            height: Of a panel, in pixels.
            pictures: Of a film strip, evenly spaced over the seconds.
            seed: Of what the world draws at random.
        """
        policy = load(run)
        place = output or _usual_output(run)
        tradeoffs = [parse_tradeoff(text, policy.objectives) for text in tradeoff]
        record(
            policy,
            place,
            tradeoffs,
            seconds,
            speed,
            width,
            height,
            pictures,
            seed,
            show_progress=cli.console.is_terminal,
        )
        cli.console.print(f"written: {place}")

    tyro.cli(main, args=arguments, prog="python -m morlax_torch.record")


def _usual_output(run: Path) -> Path:
    folder = find_run(run)
    return Path(f"{folder.name}.mp4") if folder.parent == SHIPPED else folder / "film.mp4"


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
