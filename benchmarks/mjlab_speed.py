"""Compare the speed of training a task of mjlab with mjlab's own training, in one process.

python benchmarks/mjlab_speed.py --task Mjlab-Velocity-Flat-Unitree-Go1
"""

import contextlib
import cProfile
import io
import pstats
import time
from collections.abc import Callable
from pathlib import Path

import mjlab_peer
import torch
import tyro
from rich.table import Table

from morlax_torch import MORLAX, config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device


def main(
    task: str = "Mjlab-Velocity-Flat-Unitree-Go1",
    worlds: int = 4096,
    iterations: int = 10,
    rounds: int = 2,
    device: str | None = None,
    profile: Path | None = None,
) -> None:
    """Measure steps and iterations of both, by turns, and print the best round of each.

    Args:
        task: name in mjlab's registry.
        worlds: number of worlds.
        iterations: iterations of a round.
        rounds: rounds of each.
        device: cuda or cpu (None: CUDA if available).
        profile: file for a profile of exploring.
    """
    target = str(resolve_device(device))
    config = config_for(f"mjlab:{task}", worlds=worlds, device=target)
    env = config.make_worlds(worlds, config.seed)
    morlax = MORLAX(env, config)
    morlax.compile()
    peer = mjlab_peer.make_runner(task, worlds, target)
    horizon = peer.cfg["num_steps_per_env"]
    action = torch.zeros(worlds, env.action_size, device=target)

    def peer_learns() -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            peer.learn(1, init_at_random_ep_len=False)

    def uniform() -> torch.Tensor:
        return action.uniform_(-1, 1) / env.options.action_scale

    things: dict[str, tuple[Callable[[], object], int]] = {
        "mjlab, a step": (lambda: peer.env.step(uniform()), 1),
        "the bridge, a step": (lambda: env.step(uniform()), 1),
        "rsl_rl, an iteration": (peer_learns, horizon),
        "MORLAX, an iteration": (morlax.iterate, config.horizon),
        "MORLAX, exploring": (morlax.explore, config.horizon),
        "MORLAX, learning": (morlax.learn, config.horizon),
    }
    best = dict.fromkeys(things, float("inf"))
    for _ in range(rounds):
        for name, (run, steps) in things.items():
            best[name] = min(best[name], _seconds(run, iterations * (20 if steps == 1 else 1)))
    table = Table("", "ms", "environment steps/s", title=f"{task}, {worlds} worlds, {target}")
    for name, (_, steps) in things.items():
        rate = worlds * steps / best[name]
        table.add_row(name, f"{1000 * best[name]:.2f}", f"{rate:,.0f}")
    console.print(table)
    if profile:
        with cProfile.Profile() as profiler:
            morlax.explore()
        with profile.open("w") as file:
            pstats.Stats(profiler, stream=file).sort_stats("cumulative").print_stats(120)


def _seconds(run: Callable[[], object], times: int) -> float:
    """Return the mean seconds of a run."""
    synchronize = torch.cuda.synchronize if torch.cuda.is_available() else lambda: None
    run()
    synchronize()
    start = time.perf_counter()
    for _ in range(times):
        run()
    synchronize()
    return (time.perf_counter() - start) / times


if __name__ == "__main__":
    tyro.cli(main)
