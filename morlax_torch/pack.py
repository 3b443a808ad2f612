"""Take from a run what it takes to use it: a small folder to share, or to ship."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from .runs.packing import pack
from .terminal import cli


def command(arguments: Sequence[str]) -> None:
    def main(
        run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
        output: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
        device: str | None = None,
    ) -> None:
        """Take the policies of a run, their front, config and curve into a small folder.

        Every command takes the folder for a run; only training cannot go on from it.

        Args:
            run: A run's folder (its best checkpoint), or a checkpoint in it.
            output: A new folder.
            device: That evaluates the front: cuda, cpu, ... (None: CUDA where there is one).
        """
        front = pack(run, output, device)
        size = sum(path.stat().st_size for path in output.rglob("*.*")) / 1e6
        cli.console.print(f"hypervolume {front.hypervolume:.4e}; written: {output} ({size:.1f} MB)")
        cli.console.print(f"use it: python -m morlax_torch.evaluate {shlex.quote(str(output))}")

    tyro.cli(main, args=arguments, prog="python -m morlax_torch.pack")


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
