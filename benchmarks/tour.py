"""Score trade-offs of a run by the rules of the teleop-walking-benchmark, in C MuJoCo.

    python benchmarks/tour.py runs/tour --tradeoffs 16 --runs 64 --output rows.csv
    python benchmarks/tour.py runs/tour --tradeoff 0,1,0,0 --runs 256 --first 64 # of these, again

Writes a row for each trade-off. RUN is a run of Mjlab-Tour-Flat-Unitree-G1, which is exported with
mjlab, or the folder of an export whose trade-off is an input.
"""

import tempfile
from pathlib import Path

import tyro
from row_files import write_rows

from morlax_torch.commands import export
from morlax_torch.commands.terminal.cli import console
from morlax_torch.configuration.tradeoffs import even_tradeoffs, parse_tradeoff
from morlax_torch.exports.deployment import SETTINGS
from morlax_torch.viewers.playing.robot import open_export
from morlax_torch.viewers.playing.tour import WALK, score


def main(
    run: tyro.conf.Positional[Path],
    tradeoffs: int = 16,
    tradeoff: tuple[str, ...] = (),
    runs: int = 64,
    first: int = 0,
    seconds: float = WALK,
    output: Path = Path("tour.csv"),
) -> None:
    """Write the columns of the benchmark's table for each trade-off.

    Args:
        run: Folder of a run or of an export.
        tradeoffs: Number of trade-offs, spread evenly.
        tradeoff: These trade-offs instead, such as 0,1,0,0.
        runs: Number of runs of each.
        first: Id of the first run; other ids have other commands, arms and punches.
        seconds: Duration of a run.
        output: CSV file of rows.
    """
    with tempfile.TemporaryDirectory() as folder:
        if not (run / SETTINGS).exists():
            export.command([str(run), "--output", f"{folder}/family.onnx"])
            run = Path(folder)
        objectives = open_export(run).settings.objectives
        chosen = [parse_tradeoff(text, objectives) for text in tradeoff]
        rows = []
        for weights in chosen or even_tradeoffs(tradeoffs, len(objectives)).tolist():
            row = dict(zip(objectives, weights, strict=True))
            row |= score(run, runs, weights, seconds, first)
            row |= {"runs": runs, "seconds": seconds, "first run id": first}
            rows.append({name: f"{value:.4g}" for name, value in row.items()})
            write_rows(output, rows)
            console.print(", ".join(f"{name} {value}" for name, value in rows[-1].items()))


if __name__ == "__main__":
    tyro.cli(main)
