"""Profile one training iteration: GPU kernels and milliseconds by phase.

python benchmarks/profile_iteration.py --env cheetah
"""

from collections import Counter
from pathlib import Path

import torch
import tyro
from rich.table import Table
from torch.profiler import ProfilerActivity, profile

from morlax_torch import MORLAX, config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device
from morlax_torch.gpu.graph import Graph

REPEATS = 5


def main(
    env: str = "cheetah", worlds: int | None = None, top: int = 12, output: Path | None = None
) -> None:
    """Profile the physics, explore and learn phases of one task.

    Args:
        env: Name of the task.
        worlds: Number of worlds (None: from the task's config).
        top: Number of kernels to list per phase.
        output: CSV file of all kernels: phase, kernel, calls and ms per iteration.
    """
    target = resolve_device(None)
    config = config_for(env, **({"worlds": worlds} if worlds else {}))
    morlax = MORLAX(config.make_worlds(config.worlds, config.seed), config)
    morlax.compile()
    physics = Graph(lambda: [morlax.env.physics.step() for _ in range(config.horizon)], target)
    physics.record()
    lines = ["phase,kernel,calls,ms"]
    for phase, graph in {
        "physics": physics,
        "explore": morlax.explore,
        "learn": morlax.learn,
    }.items():
        calls, times = _kernels(graph)
        table = Table(
            title=f"{env}, {phase}: {sum(times.values()):.2f} ms in {sum(calls.values())} kernels"
        )
        for column in ("kernel", "calls", "ms"):
            table.add_column(column, justify="left" if column == "kernel" else "right")
        for name, time in times.most_common():
            lines.append(f"{phase},{name.replace(',', ';')},{calls[name]},{time:.4f}")
        for name, time in times.most_common(top):
            table.add_row(name[:90], str(calls[name]), f"{time:.3f}")
        console.print(table)
    if output:
        output.write_text("\n".join(lines) + "\n")


def _kernels(graph: Graph) -> tuple[Counter[str], Counter[str]]:
    """Return the launches and milliseconds of every kernel in one replay of `graph`."""
    for _ in range(2):
        graph()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA], acc_events=True) as found:
        for _ in range(REPEATS):
            graph()
        torch.cuda.synchronize()
    calls, times = Counter(), Counter()
    for event in found.key_averages():
        if event.device_time_total:
            calls[event.key] += round(event.count / REPEATS)
            times[event.key] += event.device_time_total / 1000 / REPEATS
    return calls, times


if __name__ == "__main__":
    tyro.cli(main)
