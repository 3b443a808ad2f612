"""Seconds from the command to the first iteration, with an empty and with a full kernel cache.

python benchmarks/startup.py --env cheetah humanoid
"""

import os
import subprocess
import sys
import tempfile
import time

import tyro
from rich.table import Table

from morlax_torch.cli import console

FIRST_ITERATION = """
import os, sys, time
from morlax_torch import MORLAX
from morlax_torch.arguments import read
from morlax_torch.train import make_worlds
config, _, _ = read(sys.argv[1:])
morlax = MORLAX(make_worlds(config, config.worlds), config)
morlax.compile()
morlax.iterate()
morlax.metrics()
print(time.time() - float(os.environ["BEGAN"]))
"""


def main(
    env: tuple[str, ...] = ("cheetah",), device: str | None = None, backend: str | None = None
) -> None:
    """Measure.

    Args:
        env: Which tasks, each in two processes of its own.
        device: cuda or cpu (None: CUDA where there is one).
        backend: warp or mujoco (None: by the device).
    """
    table = Table()
    for column in ("task", "empty cache (s)", "full cache (s)"):
        table.add_column(column, justify="right")
    options = [
        *(["--device", device] if device else []),
        *(["--backend", backend] if backend else []),
    ]
    for task in env:
        with tempfile.TemporaryDirectory() as cache:
            seconds = [_first_iteration(["--env", task, *options], cache) for _ in range(2)]
        table.add_row(task, *(f"{value:.1f}" for value in seconds))
    console.print(table)


def _first_iteration(arguments: list[str], cache: str) -> float:
    done = subprocess.run(
        [sys.executable, "-c", FIRST_ITERATION, *arguments],
        env={**os.environ, "WARP_CACHE_PATH": cache, "BEGAN": str(time.time())},
        check=True,
        capture_output=True,
        text=True,
    )
    return float(done.stdout.split()[-1])


if __name__ == "__main__":
    tyro.cli(main)
