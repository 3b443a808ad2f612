"""Compare a front on a velocity task of mjlab with the policy of mjlab's own training.

python benchmarks/mjlab_front.py runs/mjlab:Mjlab-Velocity-Flat-Unitree-Go1/RUN --peer LOG
"""

import contextlib
import io
from pathlib import Path

import mjlab_peer
import tyro
from mjlab_walks import Act, Found, Walks, best, make, walk
from rich.table import Table

from morlax_torch import load
from morlax_torch.envs import resolve_device
from morlax_torch.runs import checkpoint
from morlax_torch.runs.loading import find_checkpoint
from morlax_torch.terminal.cli import console


def main(
    run: tyro.conf.Positional[Path],
    peer: Path | None = None,
    tradeoffs: int = 64,
    worlds: int = 4096,
    steps: int = 1000,
    seed: int = 0,
    device: str | None = None,
) -> None:
    """Print how the best policies of a run walk.

    Args:
        run: Folder of the run.
        peer: Folder of mjlab's own training; without a checkpoint there, mjlab trains first, for
            as many environment steps as the run.
        tradeoffs: Number of trade-offs to choose from.
        worlds: Worlds to walk in.
        steps: Control steps of each.
        seed: Seed of the worlds and of mjlab's training.
        device: cuda or cpu (None: CUDA if available).
    """
    place = resolve_device(device)
    policy = load(run, place)
    rows = best(policy, tradeoffs, worlds, steps, seed)
    if peer is not None:
        task = policy.config.env.rpartition(":")[2]
        total = checkpoint.load(find_checkpoint(run)).progress.env_steps
        act = _peer(task, peer, total, policy.config.worlds, str(place), seed)
        walks = walk(make(policy, worlds, 2 * seed + 1), act, 1, steps)
        rows.append(Found("mjlab's own training", [], Walks(*(value[0] for value in walks))))
    table = Table("", "trade-off", *Walks._fields, title=f"{policy.config.env}, {worlds} worlds")
    for row in rows:
        weights = " ".join(f"{weight:.2f}" for weight in row.tradeoff)
        table.add_row(row.label, weights, *(f"{float(value):.3g}" for value in row.walks))
    console.print(table)


def _peer(task: str, log: Path, steps: int, worlds: int, device: str, seed: int) -> Act:
    """Load mjlab's own policy, or train it first for `steps`."""
    files = sorted(log.glob("model_*.pt"), key=lambda file: file.stat().st_mtime)
    runner = mjlab_peer.runner(task, 16 if files else worlds, device, seed, log)
    if files:
        runner.load(str(files[-1]), map_location=device)
    else:
        iterations = max(1, round(steps / worlds / runner.cfg["num_steps_per_env"]))
        with contextlib.redirect_stdout(io.StringIO()):
            runner.learn(iterations, init_at_random_ep_len=True)
    policy = runner.get_inference_policy(device)
    return lambda seen: policy({"actor": seen[0]})[None]


if __name__ == "__main__":
    tyro.cli(main)
