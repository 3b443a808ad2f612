"""Measure what each Triton kernel saves, against its torch definition and torch.compile.

python benchmarks/kernels.py --env cheetah ant --output kernels.csv
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
import tyro
from row_files import write_rows
from throughput import milliseconds

from morlax_torch import MORLAX, config_for
from morlax_torch.algorithms import ppo
from morlax_torch.commands.terminal.cli import console
from morlax_torch.gpu import fused, optimizer
from morlax_torch.networks import gaussian

DEFINITIONS = {  # of the kernels, in torch
    "step": optimizer.step,
    "sample": gaussian.sample,
    "policy_loss": ppo.policy_loss,
}


def run_mlps(x: Any, sizes: Any, parameters: Any, definition: Callable[[], Any]) -> Any:
    """Run `fused.mlps` without its kernel."""
    return definition()


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
            row = {"task": config.env, "kernel": kernel, "instead": instead}
            rows.append(row | {"iteration_ms": f"{taken:.3f}", "ready_s": f"{ready:.2f}"})
            console.print(*rows[-1].values())

        measure("all", "")
        kernels = fused.kernels(worlds.device)
        assert kernels is not None
        for way, made in (("definition", lambda run: run), ("compiled", torch.compile)):
            with patch.object(fused, "mlps", made(run_mlps)):
                measure("mlps", way)
            for name, definition in DEFINITIONS.items():
                others = kernels._replace(**{name: made(definition)})
                with patch.object(fused, "kernels", lambda _, others=others: others):
                    measure(name, way)
        measure("all", "")
    if output:
        write_rows(output, rows)


if __name__ == "__main__":
    tyro.cli(main)
