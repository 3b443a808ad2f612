"""Copy what is needed to use a run into a small folder, to share or to ship."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from .envs.lazy import handed_on
from .terminal import cli
from .terminal.help import call

if TYPE_CHECKING:
    from .runs.packing import pack as pack

__getattr__, __dir__ = handed_on(__name__, {"pack": "runs.packing"})


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        output: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
        device: str | None = None,
        trust: bool = False,
    ) -> None:
        """Write a run's policies, front, config and training curve to a small folder.

        Every command accepts the folder as a run, but training cannot continue from it.

        Args:
            run: Run folder (its best checkpoint), or a checkpoint in it.
            output: New folder.
            device: Device that evaluates the front: cuda, cpu, ... (None: CUDA if there is a GPU).
            trust: Let the run import the FILE.py or module that its task names.
        """
        from .runs.loading import trust_task  # imports torch
        from .runs.packing import pack

        if trust:
            trust_task(run)
        front = pack(run, output, device)
        size = sum(path.stat().st_size for path in output.rglob("*.*")) / 1e6
        cli.console.print(f"hypervolume {front.hypervolume:.4e}; written: {output} ({size:.1f} MB)")
        cli.print_command("use it", f"python -m morlax_torch.evaluate {shlex.quote(str(output))}")

    call(main, arguments, "morlax pack")


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
