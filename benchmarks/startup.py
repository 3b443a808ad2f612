"""Seconds from the command to the first iteration, with an empty and a full cache; GPU memory.

python benchmarks/startup.py --env cheetah humanoid
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time

import tyro
from rich.table import Table

from morlax_torch.terminal.cli import console

FIRST_ITERATION = """
import os, sys, time
import torch
from morlax_torch import MORLAX
from morlax_torch.runs.training import make_worlds
from morlax_torch.terminal.arguments import read
config, _, _ = read(sys.argv[1:])
morlax = MORLAX(make_worlds(config, config.worlds), config)
morlax.compile()
morlax.iterate()
morlax.metrics()
seconds = time.time() - float(os.environ["BEGAN"])
free, total = torch.cuda.mem_get_info() if torch.cuda.is_available() else (0, 0)
print(seconds, (total - free) / 2**30)
"""


def main(
    env: tuple[str, ...] = ("cheetah",), device: str | None = None, backend: str | None = None
) -> None:
    """Measure. Nothing else should use the GPU: what is in use before counts as not ours.

    Args:
        env: Which tasks, each in two processes of its own.
        device: cuda or cpu (None: CUDA where there is one).
        backend: warp or mujoco (None: by the device).
    """
    table = Table()
    for column in ("task", "empty cache (s)", "full cache (s)", "GPU memory (GiB)"):
        table.add_column(column, justify="right")
    options = [
        *(["--device", device] if device else []),
        *(["--backend", backend] if backend else []),
    ]
    for task in env:
        before = _memory_in_use()
        with tempfile.TemporaryDirectory() as cache:
            empty, _ = _first_iteration(["--env", task, *options], cache)
            full, used = _first_iteration(["--env", task, *options], cache)
        table.add_row(task, f"{empty:.1f}", f"{full:.1f}", f"{max(0.0, used - before):.2f}")
    console.print(table)


def _memory_in_use() -> float:
    """GiB of the first GPU that are taken, asked for in a way that takes none itself."""
    if shutil.which("nvidia-smi") is None:
        return 0.0
    first = os.environ.get("CUDA_VISIBLE_DEVICES", "0").split(",")[0]
    wanted = ["--query-gpu=memory.used", "--format=csv,noheader,nounits", f"--id={first}"]
    said = subprocess.run(["nvidia-smi", *wanted], check=True, capture_output=True, text=True)
    return float(said.stdout) / 1024


def _first_iteration(arguments: list[str], cache: str) -> tuple[float, float]:
    """Seconds, and GiB of the GPU that are in use at their end."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_ITERATION, *arguments],
        env={**os.environ, "WARP_CACHE_PATH": cache, "BEGAN": str(time.time())},
        check=True,
        capture_output=True,
        text=True,
    )
    seconds, used = map(float, done.stdout.split()[-2:])
    return seconds, used


if __name__ == "__main__":
    tyro.cli(main)
