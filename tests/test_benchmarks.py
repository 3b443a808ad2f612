"""The benchmarks run and write their files; speed is not tested."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest
import throughput

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def run(script: str, *arguments: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, BENCHMARKS / f"{script}.py", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.long
def test_table1(tmp_path):
    options = ("--env", "cheetah", "--limits", "0.2", "--seeds", "3", "--device", "cpu")
    run("table1", *options, folder=tmp_path)
    (row,) = rows(tmp_path / "table1.csv")
    assert (row["env"], row["seed"]) == ("cheetah", "3")
    printed, found = float(row["printed_hypervolume"]), float(row["hypervolume"])
    assert found == pytest.approx(printed, rel=1e-4) and found > 0
    assert float(row["command_seconds"]) > float(row["first_row_seconds"]) > 0
    run("table1", *options, folder=tmp_path)
    assert rows(tmp_path / "table1.csv") == [row]  # which exists, so it is not measured again
    assert "| cheetah |" not in (tmp_path / "table1.md").read_text()  # it misses the target


@pytest.mark.slow
def test_throughput(tmp_path):
    output = tmp_path / "rows.csv"
    throughput.main(("hopper",), (128,), device="cpu", seconds=0.1, output=output)
    (row,) = rows(output)
    assert float(row["training/physics"]) > 0
