"""The benchmarks run and write their files; speed is not tested."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

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
    options = ("--env", "cheetah", "--seconds", "0.2", "--every", "0.2", "--seeds", "3")
    run("table1", *options, "--device", "cpu", folder=tmp_path)
    (row,) = rows(tmp_path / "table1.csv")
    assert (row["env"], row["seed"]) == ("cheetah", "3")
    assert float(row["hypervolume"]) > 0
    assert float(row["hypervolume_paper_protocol"]) > 0
    assert "| cheetah |" in (tmp_path / "table1.md").read_text()
    assert (tmp_path / "table1.png").stat().st_size > 1000
    run("table1", "--env", "--given", "table1.csv", "--output", "again", folder=tmp_path)
    for ending in ("csv", "md"):
        again, first = (tmp_path / f"{name}.{ending}" for name in ("again", "table1"))
        assert again.read_text() == first.read_text()


def test_throughput(tmp_path):
    options = ("--env", "hopper", "--worlds", "128", "--output", "rows.csv")
    run("throughput", *options, "--device", "cpu", "--seconds", "0.1", folder=tmp_path)
    (row,) = rows(tmp_path / "rows.csv")
    assert float(row["training/physics"]) > 0
