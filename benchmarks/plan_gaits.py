"""Plan and measure the gaits of BRUCE.

    python benchmarks/plan_gaits.py --output envs/robots/bruce/gaits.npz

Planning is deterministic: the same constants give the same gaits.
"""

from pathlib import Path

import numpy as np
import tyro
from gait_acceptance import LIMITS, MIN_WALKED, STEPS, measure
from gait_library import FORWARD, SIDEWAYS, Gait, Library
from gait_planner import Planner
from gait_walk import Walker
from rich import box
from rich.progress import track
from rich.table import Table

from morlax_torch.commands.terminal.cli import console
from morlax_torch.host.files import replacing


def plan(planner: Planner) -> Library:
    """Plan, measure and simulate a gait for every velocity of the grid (about half a minute)."""
    walker = Walker(planner)
    shape = len(FORWARD), len(SIDEWAYS)
    joints = np.zeros((*shape, 2, 8, 16), np.float32)
    base = np.zeros((*shape, 2, 8, 6), np.float32)
    walked = np.zeros(shape, np.int64)
    measured = {name: np.zeros(shape) for name in LIMITS}
    for i, j in track(list(np.ndindex(shape)), "gaits", console=console, transient=True):
        vx, vy = float(FORWARD[i]), float(SIDEWAYS[j])
        exact = planner.plan(vx, vy)
        joints[i, j], base[i, j] = exact.joints, exact.base
        gait = Gait(joints[i, j].astype(float), base[i, j].astype(float))  # rounded as in the file
        walked[i, j] = walker.walk(gait, STEPS)
        for name, value in measure(planner, gait, vx, vy).items():
            measured[name][i, j] = value
    return Library(FORWARD, SIDEWAYS, joints, base, walked, measured, planner.constants)


def table(library: Library) -> Table:
    """Tabulate the range and median of every measure, with its limits."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("measure", no_wrap=True)
    for head in ("minimum", "median", "maximum", "allowed"):
        table.add_column(head, justify="right")
    for name, values in library.measured.items():
        found = [f"{value:.3g}" for value in (values.min(), np.median(values), values.max())]
        table.add_row(name, *found, "{:g} to {:g}".format(*LIMITS[name]))
    survived = f"{(library.walked == STEPS).sum()} of {library.walked.size}"
    table.add_row(f"walks {STEPS} steps", survived, "", "", f"at least {MIN_WALKED}")
    return table


def main(output: Path) -> None:
    """Plan the 17 x 9 gaits of BRUCE and simulate each of them.

    Args:
        output: .npz file to write; the package ships envs/robots/bruce/gaits.npz.
    """
    with replacing(output) as file:
        library = plan(Planner())
        library.save(file)
    console.print(table(library))
    console.print(f"written: {output}")


if __name__ == "__main__":
    tyro.cli(main)
