"""Plan the gaits of BRUCE anew, and say how good they are."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tyro
from rich import box
from rich.progress import track
from rich.table import Table

from ... import cli
from ...files import replacing
from .acceptance import LIMITS, MIN_WALKED, STEPS, measure
from .library import FORWARD, SIDEWAYS, Library
from .planner import Gait, Planner
from .walk import Walker


def plan(planner: Planner) -> Library:
    """A gait for every velocity of the grid, measured and walked; half a minute."""
    walker = Walker(planner)
    shape = len(FORWARD), len(SIDEWAYS)
    joints = np.zeros((*shape, 2, 8, 16), np.float32)
    base = np.zeros((*shape, 2, 8, 6), np.float32)
    walked = np.zeros(shape, np.int64)
    measured = {name: np.zeros(shape) for name in LIMITS}
    for i, j in track(list(np.ndindex(shape)), "gaits", console=cli.console, transient=True):
        vx, vy = float(FORWARD[i]), float(SIDEWAYS[j])
        exact = planner.plan(vx, vy)
        joints[i, j], base[i, j] = exact.joints, exact.base
        gait = Gait(joints[i, j].astype(float), base[i, j].astype(float))  # as it will be read
        walked[i, j] = walker.walk(gait, STEPS)
        for name, value in measure(planner, gait, vx, vy).items():
            measured[name][i, j] = value
    return Library(FORWARD, SIDEWAYS, joints, base, walked, measured, planner.constants)


def table(library: Library) -> Table:
    """The worst and the median of every measure, and what is allowed."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("measure", no_wrap=True)
    for head in ("least", "median", "most", "allowed"):
        table.add_column(head, justify="right")
    for name, values in library.measured.items():
        found = [f"{value:.3g}" for value in (values.min(), np.median(values), values.max())]
        table.add_row(name, *found, "{:g} to {:g}".format(*LIMITS[name]))
    survived = f"{(library.walked == STEPS).sum()} of {library.walked.size}"
    table.add_row(f"walks {STEPS} steps", survived, "", "", f"at least {MIN_WALKED}")
    return table


def command(arguments: Sequence[str]) -> None:
    def main(output: Path) -> None:
        """Plan the 17 x 9 gaits that BRUCE may follow, and walk each in simulation.

        There is no chance in it: the same constants give the same gaits.

        Args:
            output: The file to write (.npz); the package ships its own as envs/bruce/gaits.npz.
        """
        with replacing(output) as file:
            library = plan(Planner())
            library.save(file)
        cli.console.print(table(library))
        cli.console.print(f"written: {output}")

    tyro.cli(main, args=arguments, prog="python -m morlax_torch.envs.bruce.gaits")


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
