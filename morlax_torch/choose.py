"""Choose a trade-off by what its policy must reach."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from .envs import MorlaxError
from .envs.lazy import handed_on
from .terminal import cli
from .terminal.help import call
from .terminal.startup import program

if TYPE_CHECKING:
    from .evaluation.choosing import choose as choose

__getattr__, __dir__ = handed_on(__name__, {"choose": "evaluation.choosing"})


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        maximize: Annotated[str, tyro.conf.arg(metavar="OBJECTIVE")],
        constrain: Annotated[
            tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="'run >= 2000'")
        ] = (),
    ) -> None:
        """Print the trade-off that maximizes one objective while others reach required returns.

        It searches the run's latest front, and between neighboring trade-offs.

        Args:
            run: Run folder, checkpoint file, or shipped policy.
            maximize: The objective to maximize.
            constrain: Least return of an objective.
        """
        from .evaluation.choosing import choose
        from .runs.fronts import load_front

        front = load_front(run)
        least: dict[str, float] = {}
        for name, value in map(_required, constrain):
            least[name] = max(value, least.get(name, value))
        choice = choose(front, least, maximize)
        for name, value in choice.returns.items():
            cli.console.print(f"{name:>12} {value:.4g}")
        weights = ",".join(f"{weight:.4g}" for weight in choice.tradeoff)
        cli.console.print(f"trade-off: {weights}")

    call(main, arguments, program("choose"))


def _required(text: str) -> tuple[str, float]:
    name, sign, least = text.partition(">=")
    try:
        if not sign or not name.strip() or not math.isfinite(float(least)):
            raise ValueError
        return name.strip(), float(least)
    except ValueError:
        raise MorlaxError(
            f"{text!r} is not a constraint: write OBJECTIVE >= NUMBER, such as 'run >= 2000'."
        ) from None


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
