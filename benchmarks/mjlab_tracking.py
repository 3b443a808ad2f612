"""Compare fronts of a tracking task of mjlab with policies of mjlab's own training.

python benchmarks/mjlab_tracking.py runs/jazz --peers jazz-4096.pt jazz-16384.pt
"""

from pathlib import Path
from typing import Any

import mjlab_peer
import numpy as np
import tyro
from rich.table import Table
from row_files import write_rows

from morlax_torch import load
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.config import Config
from morlax_torch.envs import resolve_device
from morlax_torch.evaluation.evaluator import make_evaluator
from morlax_torch.evaluation.front import Front

NEAR = 1.5  # times the least error, at most, of the policy with the least power
FALLS = 0.1  # share of episodes, at most, of it


def main(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    peers: tuple[Path, ...] = (),
    tradeoffs: int = 128,
    episodes: int = 16,
    seed: int = 0,
    motion: Path | None = None,
    device: str | None = None,
    output: Path | None = None,
) -> None:
    """Print how the best policies of runs and those of all corners follow, beside the peers.

    Args:
        runs: Folders of runs of one task and motion.
        peers: Checkpoints of benchmarks/mjlab_peer.py.
        tradeoffs: Number of policies of each run.
        episodes: Episodes of each policy; as many others choose which to report.
        seed: Seed of the episodes.
        motion: File to follow (None: that of the training).
        device: cuda or cpu (None: CUDA if available).
        output: CSV file of rows.
    """
    target = resolve_device(device)
    rows: list[tuple[str, Front, int]] = []
    for run in runs:
        policy = load(run, target)
        config = policy.config.model_copy(update={"device": str(target)})
        if motion is not None:
            config = config.with_task(motion_file=str(motion))
        trial, front = fronts(policy.agent, config, tradeoffs, episodes, seed)
        error, power = (quantity(trial, name) for name in ("body error (mm)", "power (W)"))
        near = (error <= NEAR * error.min()) & (trial.falls <= FALLS)
        rows.append((f"{run.name}: least body error", front, int(error.argmin())))
        rows.append(
            (f"{run.name}: least power", front, int(np.where(near, power, np.inf).argmin()))
        )
        rows += [(f"{run.name}: {name} only", front, k) for k, name in enumerate(front.objectives)]
        console.print(f"{run.name}: {front.non_dominated.sum()} of {tradeoffs} non-dominated")
    for file in peers:
        peer = mjlab_peer.load_peer(config, file)
        changed = config.with_task(**peer.task)
        _, front = fronts(peer, changed, len(peer.objectives), episodes, seed)
        rows.append((f"mjlab: {file.stem}", front, 0))
    names = rows[0][1].quantity_names
    head = ["policy", "trade-off", *names, "falls"]
    lines = []
    for name, front, k in rows:
        weights = " ".join(f"{weight:.2f}" for weight in front.tradeoffs[k])
        numbers = [f"{number:.3g}" for number in (*front.quantities[k], front.falls[k])]
        lines.append([name, weights, *numbers])
    table = Table(*head, title=f"{config.env}, {episodes} episodes")
    for line in lines:
        table.add_row(*line)
    console.print(table)
    if output is not None:
        write_rows(output, [dict(zip(head, line, strict=True)) for line in lines])


def fronts(agent: Any, config: Config, tradeoffs: int, episodes: int, seed: int) -> list[Front]:
    """Return fronts of two sets of episodes."""
    evaluator = make_evaluator(agent, config, "latched", tradeoffs, episodes, seed, sets=2)
    evaluator.compile()
    return evaluator.evaluate_sets()


def quantity(front: Front, name: str) -> np.ndarray:
    return front.quantities[:, front.quantity_names.index(name)]


if __name__ == "__main__":
    tyro.cli(main)
