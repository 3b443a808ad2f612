"""Measure what each Triton kernel saves, against its torch definition and torch.compile.

python benchmarks/kernels.py --env cheetah ant --output kernels.csv
"""

import csv
import time
from importlib import import_module
from pathlib import Path

import torch
import tyro
from throughput import milliseconds

from morlax_torch import MORLAX, config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs.replacing import replaced

KERNELS = {  # name of the kernel: where its definition stands
    "mlps": ("gpu.fused", "mlps"),
    "mlp": ("gpu.fused", "mlp"),
    "affine": ("gpu.fused", "affine"),
    "Adam": ("gpu.optimizer", "step"),
    "sample": ("algorithms.rollout", "sample"),
    "policy loss": ("algorithms.ppo", "policy_loss"),
}


def main(
    env: tuple[str, ...] = ("cheetah", "walker", "hopper", "ant", "humanoid"),
    seconds: float = 0.5,
    output: Path | None = None,
) -> None:
    """Measure training iterations with all kernels, without each, and with torch.compile instead.

    Args:
        env: Tasks to measure.
        seconds: Approximate duration of each measurement, in seconds.
        output: CSV file to write.
    """
    rows = []
    for task in env:
        config = config_for(task, device="cuda")
        worlds = config.make_worlds(config.worlds, config.seed)

        def measure(kernel: str, instead: str, config=config, worlds=worlds) -> None:
            start = time.perf_counter()
            learner = MORLAX(worlds, config)
            learner.compile()
            ready = time.perf_counter() - start
            taken = milliseconds(learner.iterate, seconds)
            rows.append([config.env, kernel, instead, f"{taken:.3f}", f"{ready:.2f}"])
            console.print(*rows[-1])

        measure("all", "")
        for kernel, (module, name) in KERNELS.items():
            owner = import_module(f"morlax_torch.{module}")
            definition = getattr(owner, name).__wrapped__
            for way, run in (("definition", definition), ("compiled", torch.compile(definition))):
                with replaced(owner, name, run):
                    measure(kernel, way)
        measure("all", "")
    if output:
        with output.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["task", "kernel", "instead", "iteration_ms", "ready_s"])
            writer.writerows(rows)


if __name__ == "__main__":
    tyro.cli(main)
