"""Compare policies for many bodies with specialists, each trained on one body that they never saw.

    python benchmarks/designs.py runs/design/cheetah --bodies 16 --seconds 60

A row of the CSV file is a body: its design, and the hypervolume of its own front from the family
and from a specialist, which is trained with one body and otherwise the same config.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tyro
from row_files import write_rows

import morlax_torch
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import load_config
from morlax_torch.configuration.files import merged, task_values
from morlax_torch.envs import resolve_device
from morlax_torch.envs.worlds.design_space import DesignSpace
from morlax_torch.networks.policy import Policy
from morlax_torch.runs.loading import evaluate
from morlax_torch.train import train

UNSEEN = 2**61  # seed of the bodies, which neither training nor its evaluations have


def main(
    run: tyro.conf.Positional[str],
    bodies: int = 16,
    seconds: float = 0.0,
    clusters: int | None = None,
    seed: int = 0,
    device: str | None = None,
    output: Path = Path("designs.csv"),
) -> None:
    """Evaluate a family on bodies that it never saw, and train a specialist for each.

    Args:
        run: The run of the family.
        bodies: Number of unseen bodies, spread evenly.
        seconds: Training of a specialist (0: train none).
        clusters: Clusters of a specialist (None: as the task's config).
        seed: Seed of the specialists.
        device: "cuda" or "cpu" (None: CUDA if there is a GPU).
        output: The CSV file.
    """
    target = resolve_device(device)
    policy = morlax_torch.load(run, target)
    space = DesignSpace(policy.agent.designs)
    usual = evaluate(policy, device=str(target)).hypervolume
    console.print(f"body of the run: {usual:.4e}")
    rows = []
    for design in space.spread(bodies, UNSEEN):
        named = space.named(design)
        family = evaluate(policy.for_design(named), device=str(target)).hypervolume
        row = {**named, "family": family}
        if seconds:
            row["specialist"] = specialist(policy, named, seconds, clusters, seed, target.type)
        rows.append(row)
        write_rows(output, rows)
        console.print(", ".join(f"{name} {value:.4g}" for name, value in row.items()))
    measured = [name for name in ("family", "specialist") if name in rows[0]]
    mean = {name: np.mean([row[name] for row in rows]) for name in measured}
    console.print("mean: " + ", ".join(f"{name} {value:.4e}" for name, value in mean.items()))


def specialist(
    policy: Policy,
    design: dict[str, float],
    seconds: float,
    clusters: int | None,
    seed: int,
    device: str,
) -> float:
    """Train with one body alone, and return the hypervolume of its front."""
    own = policy.config
    changes = {
        "seed": seed,
        "device": device,
        "max_env_steps": None,
        "max_seconds": seconds,
        "sampling": {"designs": 0, **({"clusters": clusters} if clusters else {})},
        "evaluation": {"tradeoffs": own.evaluation.tradeoffs},
        "task": {"design": design},
    }
    config = load_config(merged(task_values(own.env, device), changes))
    with TemporaryDirectory() as folder:
        found = morlax_torch.load(train(config, output=Path(folder) / "run").folder)
        return evaluate(found, device=device).hypervolume


if __name__ == "__main__":
    cli.run(lambda arguments: tyro.cli(main, args=arguments))
