"""Compare fronts on a velocity task of mjlab with policies of mjlab's own training.

python benchmarks/mjlab_front.py runs/go1-0 runs/go1-1 --peers default.pt effort.pt
"""

from pathlib import Path

import mjlab_peer
import tyro
from matplotlib.figure import Figure
from mjlab_walks import ERROR, POWER, dominated, walk
from rich.table import Table
from row_files import write_rows

from morlax_torch import load
from morlax_torch.commands.terminal.cli import console
from morlax_torch.envs import resolve_device


def main(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    peers: tuple[Path, ...] = (),
    tradeoffs: int = 64,
    episodes: int = 96,
    seed: int = 0,
    device: str | None = None,
    output: Path | None = None,
    figure: Path | None = None,
) -> None:
    """Print how the best policies of runs walk, and which of their fronts dominate the peers.

    Args:
        runs: Folders of runs of one task.
        peers: Checkpoints of benchmarks/mjlab_peer.py. Of ParetoPPO's, the focus walks.
        tradeoffs: Number of policies of each run.
        episodes: Episodes that each policy walks. With 24, errors vary by 6 % with their commands.
        seed: Seed of the episodes.
        device: cuda or cpu (None: CUDA if available).
        output: CSV file of rows.
        figure: Image of all policies and the peers.
    """
    target = resolve_device(device)
    rows, fronts, verdicts = [], [], []
    drawing = Figure(figsize=(4.2, 3.2), layout="constrained")
    axes = drawing.subplots()
    for run in runs:
        policy = load(run, target)
        config = policy.config.model_copy(update={"device": str(target)})
        walks = walk(policy.agent, config, tradeoffs, episodes, seed)
        free = {"non-dominated": str((~dominated(walks.returns, walks.returns)).sum())}
        for label, index in (("best tracking", walks.best), ("least power", walks.cheapest)):
            weights, values = walks.told(index)
            rows.append((run.name, label, weights, values | free))
        fronts.append(walks.returns)
        axes.scatter(*walks.front.quantities[:, [ERROR, POWER]].T, s=14, label=run.stem)
    for file in peers:
        peer = mjlab_peer.load_peer(config, file)
        walks = walk(peer, config.with_task(**peer.task), tradeoffs, episodes, seed)
        rows.append((f"mjlab: {file.stem}", "", [], walks.told(0)[1]))
        label = f"{file.stem}, one policy"
        axes.scatter(*walks.front.quantities[0, [ERROR, POWER]], s=70, marker="*", label=label)
        better = [
            run.name
            for run, front in zip(runs, fronts, strict=True)
            if dominated(walks.returns[:, :1], front)[0]
        ]
        verdicts.append(f"mjlab: {file.stem}: dominated by {', '.join(better) or 'no front'}")
    shown = list(rows[0][3])
    heads = (f"{name}\n{label}" for name, label, *_ in rows)
    table = Table("", *heads, title=f"{config.env}, {episodes} episodes")
    table.add_row(
        "trade-off", *(" ".join(f"{w:.2f}" for w in weights) for _, _, weights, _ in rows)
    )
    for key in shown:
        table.add_row(key, *(values.get(key, "") for *_, values in rows))
    console.print(table)
    console.print(*verdicts, sep="\n")
    axes.set(xlabel="error of the velocity (m/s)", ylabel="power (W)")
    axes.legend()
    if figure is not None:
        drawing.savefig(figure, dpi=150)
    if output is not None:
        columns = ["run", "policy", "tradeoff", *shown]
        policies = [
            {"run": name, "policy": label, "tradeoff": weights, **values}
            for name, label, weights, values in rows
        ]
        write_rows(output, policies, columns)


if __name__ == "__main__":
    tyro.cli(main)
