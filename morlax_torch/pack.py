"""Take from a run what it takes to use it: a small folder to share, or to ship."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from . import cli
from .envs import MorlaxError
from .evaluate import evaluate
from .evaluation import Front
from .files import replacing
from .policy import find_run, load


def pack(run: str | Path, output: Path, device: str | None = None) -> Front:
    """Write the policies of a run's best checkpoint, their front, and how they came about.

    The folder has the shape of a run, so every command takes it for one; only to train on, it
    lacks critic and optimisers. The front is evaluated anew, by 512 trade-offs, and returned.

    Raises:
        MorlaxError: there is no such run, or `output` is taken or cannot be written.
    """
    if output.exists():
        raise MorlaxError(f"{output} is there already: choose another folder.")
    source, policy = find_run(run), load(run)
    front = evaluate(policy, device=device)
    kept = {}
    for name in ("config.yaml", "metrics.csv"):
        try:
            kept[name] = (source / name).read_bytes()
        except OSError as error:
            raise MorlaxError(f"cannot read {source / name}: {error.strerror}.") from None
    try:
        (output / "checkpoints").mkdir(parents=True)
    except OSError as error:
        raise MorlaxError(f"cannot make {output}: {error.strerror}.") from None
    policy.cpu().save(output / "checkpoints" / "best.pt")
    front.save(output / "front.npz")
    for name, contents in kept.items():
        with replacing(output / name) as file:
            file.write(contents)
    return front


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
