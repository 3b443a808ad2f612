"""Measure what speeds up MuJoCo Warp's step: options, buffers, block sizes, number of worlds.

    python benchmarks/physics.py --env cheetah --trials iterations=2 block.linesearch_iterative=64

Every trial is measured between two runs of the task's own settings, and printed as the ratio to
their mean.
"""

from dataclasses import fields
from pathlib import Path

import mujoco_warp
import torch
import tyro
from row_files import write_rows
from throughput import milliseconds

from morlax_torch import config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import MorlaxError, resolve_device
from morlax_torch.envs.physics.warp import WarpPhysics
from morlax_torch.gpu.graph import Graph

COLUMNS = "task", "trial", "steps/s before", "steps/s", "steps/s after", "ratio", "MuJoCo Warp"
STEPS = 20  # control steps of a recorded graph
BUFFERS = "nconmax", "njmax"
TRIALS = (
    *("worlds=16384", "worlds=32768", "worlds=65536"),
    *("graph_conditional=0", "graph_conditional=1"),
    *("iterations=1", "iterations=2", "iterations=4", "iterations=8"),
    *("ls_iterations=4", "ls_iterations=6", "ls_iterations=10", "ls_iterations=20"),
    *("block.linesearch_iterative=64", "block.linesearch_iterative=128"),
    *("block.update_gradient_cholesky=32", "block.update_gradient_cholesky=128"),
    *("block.update_gradient_JTDAJ_dense=64", "block.update_gradient_JTDAJ_dense=256"),
)


def main(
    env: tuple[str, ...] = ("cheetah", "walker", "hopper", "ant", "humanoid"),
    trials: tuple[str, ...] = TRIALS,
    worlds: int | None = None,
    device: str | None = None,
    seconds: float = 1.0,
    output: Path | None = None,
) -> None:
    """Measure physics steps per second under random actions.

    Args:
        env: Tasks to measure.
        trials: Settings, one each: worlds, nconmax, njmax, an option of MuJoCo Warp, or
            block.NAME for a size of its thread blocks.
        worlds: Number of worlds (None: the task's).
        device: cuda or cpu (None: CUDA if available).
        seconds: Approximate duration of each measurement, in seconds.
        output: CSV file to write.
    """
    target, version = resolve_device(device), mujoco_warp.__version__
    rows = []
    for task in env:
        before = steps_per_second(task, worlds, "", target, seconds)
        for trial in trials:
            found = steps_per_second(task, worlds, trial, target, seconds)
            after = steps_per_second(task, worlds, "", target, seconds)
            ratio = 2 * found / (before + after)
            cells = (task, trial, before, found, after, ratio, version)
            rows.append(dict(zip(COLUMNS, cells, strict=True)))
            if output:
                write_rows(output, rows)
            console.print(f"{task} {trial}: {found:.4g} steps/s, {ratio:.3f} times as fast")
            before = after


def steps_per_second(
    task: str, worlds: int | None, trial: str, device: torch.device, seconds: float
) -> float:
    """Return physics steps per second of all worlds; NaN if contacts overflow their buffers."""
    name, _, value = trial.partition("=")
    changes = {f"task.{name}": int(value)} if name in BUFFERS else {}
    config = config_for(task, device=str(device), backend="warp", **changes)
    number = int(value) if name == "worlds" else worlds or config.worlds
    env = config.make_worlds(number, config.seed)
    assert isinstance(env.physics, WarpPhysics)
    model = env.physics._model
    owner = model.block_dim if name.startswith("block.") else model.opt
    if name and name not in (*BUFFERS, "worlds"):
        key = name.removeprefix("block.")
        if key not in {field.name for field in fields(owner)}:
            raise MorlaxError(f"MuJoCo Warp has no setting {name}.")
        setattr(owner, key, type(getattr(owner, key))(int(value)))

    def act() -> None:
        for _ in range(STEPS):
            env.physics.ctrl.uniform_(-1, 1, generator=env.generator)
            env.physics.step()

    act()
    run = Graph(act, device, [env.generator])
    run.record()
    found = milliseconds(run, seconds)
    if env.overflow().any():
        return float("nan")
    return 1000 * number * STEPS * env.physics.substeps / found


if __name__ == "__main__":
    tyro.cli(main)
