"""Random search for a task's hyperparameters, scored by the hypervolume curve.

    python benchmarks/search.py --env cheetah --trials 20 --seconds 15 --output cheetah.csv

Every trial trains for the same number of seconds. Its CSV row holds the changed options, the speed
(steps/s), the seconds to reach HYPER-MORL's and the paper's maximum, the best hypervolume and the
curve. Trial 0 is the task's default config.
"""

import csv
import random
from pathlib import Path

import tyro
import yaml
from training_curve import TARGETS, reached, training_curve

from morlax_torch import MorlaxError, config_for
from morlax_torch.envs import resolve_device
from morlax_torch.terminal.cli import console

SPACE = {
    "worlds": (2048, 4096, 8192),
    "horizon": (10, 16, 20, 30),
    "sampling.clusters": (8, 16, 32),
    "ppo.learning_rate": (3e-4, 5e-4, 1e-3),
    "ppo.critic_learning_rate": (None, 1e-3, 2e-3),
    "ppo.minibatches": (2, 4, 8),
    "ppo.epochs": (3, 4, 6),
    "ppo.discount": (0.98, 0.99, 0.995),
    "ppo.gae_lambda": (0.9, 0.95),
    "ppo.clip": (0.2, 0.3),
    "ppo.entropy": (0.003, 0.01, 0.02, 0.03),
    "ppo.anneal": (False, True),
    "network.initial_std": (0.15, 0.3, 0.694),
    "network.features": (16, 32),
    "task.stagger": (False, True),
}


def main(
    env: str,
    trials: int = 10,
    seconds: float = 15.0,
    seeds: int = 1,
    changes: int = 4,
    first: int = 0,
    every: float = 1.0,
    given: Path | None = None,
    output: Path = Path("search.csv"),
) -> None:
    """Search for hyperparameters.

    Args:
        env: Name of the task.
        trials: Number of configs to try.
        seconds: Training time per run, in seconds.
        seeds: Number of random seeds per config.
        changes: Maximum number of options that a trial changes.
        first: Number of the first trial; the same number always gives the same trial.
        every: Training seconds between evaluations.
        given: YAML list of changes to try instead of random ones.
        output: CSV file to append a row to after every run.
    """
    place = resolve_device(None)
    listed = yaml.safe_load(given.read_text()) if given else None
    for number in range(len(listed)) if listed else range(first, first + trials):
        change = listed[number] if listed else draw(number, changes)
        for seed in range(seeds):
            row = [env, number, seed, change]
            try:
                config = config_for(env, seed=seed, device=str(place), **change)
                points = training_curve(config, seconds, every)
                first = [reached(points, target) for target in TARGETS.get(env, ())]
                row += [
                    round(points[-1].env_steps / points[-1].train_seconds),
                    [found and found.train_seconds for found in first],
                    max(point.hypervolume["latched"] for point in points),
                    [f"{p.train_seconds:.1f}:{p.hypervolume['latched']:.3g}" for p in points],
                ]
            except MorlaxError as error:
                row.append(str(error))
            console.print(row)
            with output.open("a", newline="") as file:
                csv.writer(file).writerow(row)


def draw(number: int, changes: int) -> dict[str, object]:
    """Draw the options that trial `number` changes; trial 0 changes nothing."""
    if number == 0:
        return {}
    chance = random.Random(number)
    names = chance.sample(list(SPACE), chance.randint(1, changes))
    return {name: chance.choice(SPACE[name]) for name in names}


if __name__ == "__main__":
    tyro.cli(main)
