"""Try configs on a velocity task of mjlab, scored by how their best policies walk.

    python benchmarks/mjlab_search.py --given trials.yaml --trials 0 3 --seconds 300

trials.yaml is a list of changes to the task's config. Several processes can share a GPU: in sum,
two of them were as fast as one, but no faster.
"""

import csv
import time
from pathlib import Path

import tyro
import yaml
from mjlab_walks import Walks, best

from morlax_torch import MORLAX, config_for
from morlax_torch.envs import resolve_device
from morlax_torch.networks.policy import Policy
from morlax_torch.runs.loading import save
from morlax_torch.runs.training import make_worlds
from morlax_torch.terminal.cli import console


def main(
    given: Path,
    task: str = "Mjlab-Velocity-Flat-Unitree-Go1",
    trials: tuple[int, ...] = (),
    seconds: float = 300.0,
    every: float = 30.0,
    seed: int = 0,
    tradeoffs: int = 48,
    worlds: int = 1024,
    steps: int = 500,
    device: str | None = None,
    output: Path = Path("mjlab-search"),
) -> None:
    """Train with each trial's config for the same time, and see how its best policies walk.

    Args:
        given: YAML list of changes.
        task: Name in mjlab's registry.
        trials: Which of them to try (none: all).
        seconds: Training time of each, in seconds.
        every: Training seconds between lines of progress.
        seed: Seed of training and of the worlds.
        tradeoffs: Number of trade-offs to choose the best policies from.
        worlds: Worlds to walk in.
        steps: Control steps of each.
        device: cuda or cpu (None: CUDA if available).
        output: Folder for a CSV file of rows, and for each trial's policies.
    """
    place = str(resolve_device(device))
    listed = yaml.safe_load(given.read_text())
    output.mkdir(parents=True, exist_ok=True)
    for number in trials or range(len(listed)):
        changes = listed[number] or {}
        config = config_for(f"mjlab:{task}", seed=seed, device=place, **changes)
        morlax = MORLAX(make_worlds(config, config.worlds), config)
        morlax.compile()
        start = shown = time.perf_counter()
        while (passed := time.perf_counter() - start) < seconds:
            morlax.iterate()
            if time.perf_counter() - shown > every:
                rewards = {
                    name: f"{value:.4f}"
                    for name, value in morlax.metrics().items()
                    if name.startswith("mean_reward") or name in ("terminated", "entropy", "kl")
                }
                console.print(number, f"{passed:.0f} s", f"{morlax.env_steps / 1e6:.1f} M", rewards)
                shown = time.perf_counter()
        policy = Policy(morlax.agent, config, morlax.env.objectives)
        save(policy, output / f"{task}-{number}-{seed}.pt")
        for found in best(policy, tradeoffs, worlds, steps, seed):
            means = [f"{float(value):.3g}" for value in found.walks]
            weights = [round(weight, 2) for weight in found.tradeoff]
            walks = dict(zip(Walks._fields, means, strict=True))
            row = [task, number, seed, morlax.env_steps, found.label, weights, walks, changes]
            console.print(row)
            with (output / "rows.csv").open("a", newline="") as file:
                csv.writer(file).writerow(row)


if __name__ == "__main__":
    tyro.cli(main)
