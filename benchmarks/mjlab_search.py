"""Try configs on a velocity task of mjlab, scored by how the policies of their fronts walk.

    python benchmarks/mjlab_search.py --given trials.yaml --trials 0 3 --seconds 300

trials.yaml is a list of changes to the task's config.
"""

import csv
import time
from pathlib import Path

import tyro
import yaml
from mjlab_walks import dominated, walk

from morlax_torch import MORLAX, config_for
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device
from morlax_torch.networks.policy import Policy
from morlax_torch.runs.loading import save

SHOWN = ("mean_reward", "terminated", "entropy", "kl", "learning_rate")


def main(
    given: Path,
    task: str = "Mjlab-Velocity-Flat-Unitree-Go1",
    trials: tuple[int, ...] = (),
    seconds: float = 300.0,
    every: float = 30.0,
    seed: int = 0,
    tradeoffs: int = 64,
    episodes: int = 24,
    device: str | None = None,
    output: Path = Path("mjlab-search"),
) -> None:
    """Train with each trial's config for the same time, and see how its policies walk.

    Args:
        given: YAML list of changes.
        task: Name in mjlab's registry.
        trials: Which of them to try (none: all).
        seconds: Training time of each, in seconds.
        every: Training seconds between lines of progress.
        seed: Seed of training and of the worlds.
        tradeoffs: Number of policies of each.
        episodes: Episodes that each policy walks.
        device: cuda or cpu (None: CUDA if available).
        output: Folder for a CSV file of rows, and for each trial's policies and front.
    """
    target = str(resolve_device(device))
    listed = yaml.safe_load(given.read_text())
    output.mkdir(parents=True, exist_ok=True)
    for number in trials or range(len(listed)):
        changes = listed[number] or {}
        config = config_for(f"mjlab:{task}", seed=seed, device=target, **changes)
        morlax = MORLAX(config.make_worlds(config.worlds, config.seed), config)
        morlax.compile()
        start = shown = time.perf_counter()
        while (passed := time.perf_counter() - start) < seconds:
            morlax.iterate(passed / seconds)
            if time.perf_counter() - shown > every:
                found = morlax.metrics()
                progress = {k: f"{v:.3g}" for k, v in found.items() if k.startswith(SHOWN)}
                console.print(
                    number, f"{passed:.0f} s", f"{morlax.env_steps / 1e6:.1f} M", progress
                )
                shown = time.perf_counter()
        policy = Policy(morlax.agent, config, morlax.env.objectives)
        name = f"{task}-{number}-{seed}"
        save(policy, output / f"{name}.pt")
        walks = walk(policy.agent, config, tradeoffs, episodes, seed)
        walks.front.save(output / f"{name}.npz")
        free = int((~dominated(walks.returns, walks.returns)).sum())
        for label, index in (("best tracking", walks.best), ("least power", walks.cheapest)):
            row = [number, seed, morlax.env_steps, free, label, *walks.told(index)]
            console.print(row)
            with (output / "rows.csv").open("a", newline="") as file:
                csv.writer(file).writerow(row)


if __name__ == "__main__":
    tyro.cli(main)
