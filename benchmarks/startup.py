"""Measure startup time (to the first iteration, with a cold and a warm cache) and GPU memory.

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

from morlax_torch.commands.terminal.cli import console

FIRST_ITERATION = """
import os, sys, time
import torch
from morlax_torch import MORLAX
from morlax_torch.commands.terminal.arguments import read
config, _, _ = read(sys.argv[1:])
morlax = MORLAX(config.make_worlds(config.worlds, config.seed), config)
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
    """Measure startup time and GPU memory.

    Run nothing else on the GPU: memory in use at the start is subtracted as other programs'.

    Args:
        env: Tasks to measure, each in two separate processes.
        device: cuda or cpu (None: CUDA if available).
        backend: warp or mujoco (None: chosen by the device).
    """
    table = Table()
    for column in ("task", "cold cache (s)", "warm cache (s)", "GPU memory (GiB)"):
        table.add_column(column, justify="right")
    options = [
        *(["--device", device] if device else []),
        *(["--backend", backend] if backend else []),
    ]
    for task in env:
        before = _memory_in_use()
        with tempfile.TemporaryDirectory() as cache:
            cold, _ = _first_iteration(["--env", task, *options], cache)
            warm, used = _first_iteration(["--env", task, *options], cache)
        table.add_row(task, f"{cold:.1f}", f"{warm:.1f}", f"{max(0.0, used - before):.2f}")
    console.print(table)


def _memory_in_use() -> float:
    """Return GiB in use on the first GPU, queried without creating a CUDA context."""
    if shutil.which("nvidia-smi") is None:
        return 0.0
    first = os.environ.get("CUDA_VISIBLE_DEVICES", "0").split(",")[0]
    query = ["--query-gpu=memory.used", "--format=csv,noheader,nounits", f"--id={first}"]
    done = subprocess.run(["nvidia-smi", *query], check=True, capture_output=True, text=True)
    return float(done.stdout) / 1024


def _first_iteration(arguments: list[str], cache: str) -> tuple[float, float]:
    """Return seconds to the end of the first iteration and GiB then in use on the GPU."""
    caches = {"WARP_CACHE_PATH": f"{cache}/warp", "TRITON_CACHE_DIR": f"{cache}/triton"}
    done = subprocess.run(
        [sys.executable, "-c", FIRST_ITERATION, *arguments],
        env={**os.environ, **caches, "BEGAN": str(time.time())},
        check=True,
        capture_output=True,
        text=True,
    )
    seconds, used = map(float, done.stdout.split()[-2:])
    return seconds, used


if __name__ == "__main__":
    tyro.cli(main)
