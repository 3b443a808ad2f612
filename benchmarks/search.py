"""Random search for a task's hyperparameters, scored by the hypervolume's curve.

    python benchmarks/search.py --env cheetah --trials 20 --seconds 15 --output cheetah.csv

Every trial trains for the same number of seconds; its row in the CSV holds what was changed, the
time to each target and the best hypervolume. Trial 0 is the task's own config.
"""

import csv
import random
import time
from pathlib import Path

import torch
import tyro
import yaml

from morlax_torch import MORLAX, MorlaxError
from morlax_torch.cli import console
from morlax_torch.config import Config, load_config, merged, task_values
from morlax_torch.envs import resolve_device
from morlax_torch.evaluation import Evaluator
from morlax_torch.tradeoffs import evaluation_tradeoffs
from morlax_torch.train import make_worlds

SPACE = {
    "worlds": (2048, 4096, 8192),
    "horizon": (10, 16, 20, 30),
    "sampling.clusters": (8, 16, 32),
    "ppo.learning_rate": (3e-4, 5e-4, 1e-3, 2e-3),
    "ppo.critic_learning_rate": (None, 1e-3, 2e-3),
    "ppo.minibatches": (2, 4, 8),
    "ppo.epochs": (2, 3, 4, 5),
    "ppo.discount": (0.98, 0.99, 0.995),
    "ppo.gae_lambda": (0.9, 0.95),
    "ppo.clip": (0.2, 0.3),
    "ppo.entropy": (0.003, 0.01, 0.02, 0.03),
    "network.scale": (0.0, 0.02),
    "task.stagger": (False, True),
}
TARGETS = {  # HYPER-MORL's maximum and the paper's MORLAX maximum, of its Table I
    "cheetah": (5.58e6, 5.78e6),
    "walker": (5.28e6, 6.48e6),
    "ant": (2.70e7, 2.81e7),
    "hopper": (6.0e6, 1.48e7),
    "humanoid": (0.74e6, 5.45e6),
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
    """Search.

    Args:
        env: The task.
        trials: How many configs to try.
        seconds: Training time of each.
        seeds: How many seeds of each.
        changes: How many values of the space a trial changes, at most.
        first: Number of the first trial; trials are the same for the same number.
        every: Training seconds between evaluations.
        given: A YAML list of changes to try instead of random ones.
        output: Where the rows go, as they come.
    """
    place = resolve_device(None)
    if place.type == "cuda":
        torch.set_float32_matmul_precision("high")
    listed = yaml.safe_load(given.read_text()) if given else None
    numbers = range(len(listed)) if listed else range(first, first + trials)
    for number in numbers:
        change = listed[number] if listed else draw(number, changes)
        for seed in range(seeds):
            row = {"env": env, "trial": number, "seed": seed, "change": change}
            try:
                row |= trial(configured(env, change, seed, str(place)), seconds, every)
            except MorlaxError as error:
                row |= {"error": str(error)}
            console.print(row)
            with output.open("a", newline="") as file:
                csv.writer(file).writerow(row.values())


def draw(number: int, changes: int) -> dict[str, object]:
    """The changes of a trial."""
    if number == 0:
        return {}
    chance = random.Random(number)
    names = chance.sample(list(SPACE), chance.randint(1, changes))
    return {name: chance.choice(SPACE[name]) for name in names}


def configured(env: str, change: dict[str, object], seed: int, device: str) -> Config:
    values = merged(task_values(env, torch.device(device).type), {"seed": seed, "device": device})
    for name, value in change.items():
        *sections, key = name.split(".")
        nested = {key: value}
        for section in reversed(sections):
            nested = {section: nested}
        values = merged(values, nested)
    return load_config(values)


def trial(config: Config, seconds: float, every: float) -> dict[str, object]:
    """Train; the speed, the times to the targets, the best hypervolume and the whole curve."""
    env = make_worlds(config, config.worlds)
    morlax = MORLAX(env, config)
    tradeoffs = evaluation_tradeoffs(config.evaluation.tradeoffs, len(env.objectives))
    judges = make_worlds(config, len(tradeoffs), auto_reset=False)
    evaluator = Evaluator(morlax.agent, judges, tradeoffs)
    morlax.compile()
    evaluator.compile()
    trained, curve = 0.0, []
    while trained < seconds:
        start = time.perf_counter()
        while time.perf_counter() - start < every:
            morlax.iterate()
            if device_is_behind(morlax):
                torch.cuda.synchronize()
        metrics = morlax.metrics()
        trained += time.perf_counter() - start
        curve.append((round(trained, 2), evaluator.evaluate().hypervolume))
        if not abs(metrics["value_loss"]) < float("inf"):
            break
    reached = [
        next((at for at, value in curve if value >= target), None)
        for target in TARGETS.get(config.env, ())
    ]
    return {
        "steps_per_second": morlax.env_steps / trained,
        "reached": reached,
        "best": max(value for _, value in curve),
        "curve": [f"{at:.1f}:{value:.3g}" for at, value in curve],
    }


def device_is_behind(morlax: MORLAX) -> bool:
    """Launching runs ahead of the GPU; waiting now and then keeps the clock honest."""
    return morlax.env.device.type == "cuda" and morlax.iteration % 4 == 0


if __name__ == "__main__":
    tyro.cli(main)
