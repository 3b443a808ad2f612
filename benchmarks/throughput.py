"""Measure the throughput of physics, exploration and learning in one process.

python benchmarks/throughput.py --env cheetah --worlds 1024 4096 16384
"""

import time
from collections.abc import Callable
from pathlib import Path

import torch
import tyro
from rich.table import Table
from row_files import write_rows

from morlax_torch import MORLAX, config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device
from morlax_torch.gpu.graph import Graph


def main(
    env: tuple[str, ...] = ("cheetah", "walker", "hopper", "ant", "humanoid"),
    worlds: tuple[int, ...] = (),
    device: str | None = None,
    seconds: float = 1.5,
    output: Path | None = None,
) -> None:
    """Measure physics alone (random actions), explore, learn and full training iterations.

    Args:
        env: Tasks to measure.
        worlds: Numbers of worlds to try (none: from the task's config).
        device: cuda or cpu (None: CUDA if available).
        seconds: Approximate duration of each measurement, in seconds.
        output: CSV file to write.
    """
    target = resolve_device(device)
    rows = []
    for task in env:
        for number in worlds or (config_for(task, device=str(target)).worlds,):
            rows.append(measure(task, number, target, seconds))
    table = Table(title=str(target))
    for column in rows[0]:
        table.add_column(column.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()))
    console.print(table)
    if output:
        write_rows(output, rows)


def measure(
    task: str, worlds: int, device: torch.device, seconds: float
) -> dict[str, str | int | float]:
    """Measure one row: milliseconds per phase of an iteration, and environment steps per second."""
    config = config_for(task, worlds=worlds, device=str(device))
    env = config.make_worlds(worlds, config.seed)
    morlax = MORLAX(env, config)
    morlax.compile()

    def act() -> None:
        for _ in range(config.horizon):
            env.physics.ctrl.uniform_(-1, 1, generator=env.generator)
            env.physics.step()

    learn = milliseconds(morlax.learn, seconds)
    explore = milliseconds(morlax.explore, seconds)
    both = milliseconds(morlax.iterate, seconds)
    physics = Graph(act, device, [env.generator])
    physics.record()
    raw = milliseconds(physics, seconds)
    steps = worlds * config.horizon
    return {
        "task": task,
        "worlds": worlds,
        "physics_ms": raw,
        "explore_ms": explore,
        "learn_ms": learn,
        "iteration_ms": both,
        "physics_Msteps/s": steps / raw / 1e3,
        "training_Msteps/s": steps / both / 1e3,
        "training/physics": raw / both,
    }


def milliseconds(run: Callable[[], None], seconds: float) -> float:
    """Return the mean milliseconds per call, repeating calls for about `seconds`."""
    synchronize = torch.cuda.synchronize if torch.cuda.is_available() else lambda: None
    for _ in range(2):
        run()
    synchronize()
    start, calls = time.perf_counter(), 0
    while (passed := time.perf_counter() - start) < seconds:
        for _ in range(5):
            run()
        synchronize()
        calls += 5
    return 1000 * passed / calls


if __name__ == "__main__":
    tyro.cli(main)
