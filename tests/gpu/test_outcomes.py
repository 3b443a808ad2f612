"""Options of the tests themselves, and the record of their runs on a GPU."""

import sys
from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest
from same import csv_rows

RECORD = Path(__file__).parents[1] / "gpu_runs.csv"
TESTS = """
import pytest

def test_passes():
    pass

@pytest.mark.skip("no telescope")
def test_skipped():
    pass

def test_chosen(pytestconfig):
    if pytestconfig.option.keyword == "":
        pytest.skip("no star")
"""


@pytest.fixture
def run(tmp_path, capfd) -> Callable[..., tuple[int, str]]:
    """Return a function that runs tests with options, and returns the status and the output."""
    (tmp_path / "pytest.ini").touch()

    def run(*options: str) -> tuple[int, str]:
        (tmp_path / "test_own.py").write_text(TESTS)
        sys.modules.pop("test_own", None)
        fixed = ["-p", "no:xdist", "-p", "no:cacheprovider", "-p", "outcomes"]
        fixed += ["--rootdir", str(tmp_path), "--import-mode", "importlib"]
        status = pytest.main([*fixed, *options, str(tmp_path)])
        return int(status), capfd.readouterr().out

    return run


def test_another_number_of_skipped_tests_is_a_failure(run):
    status, output = run("--skips", "2", "-rs")
    assert status == 0 and "instead of" not in output
    assert "no telescope" in output and "no star" in output
    for number in "1", "3":
        status, output = run("--skips", number)
        assert status == 1
        assert f"ERROR: 2 tests were skipped instead of {number}" in output
    assert run()[0] == 0  # without the option any number is right


def test_the_last_run_on_a_gpu_had_no_failure():
    recorded = csv_rows(RECORD)
    assert all(date.fromisoformat(row["date"]) for row in recorded)
    assert recorded, "run the GPU tests with --record-gpu tests/gpu_runs.csv, see CONTRIBUTING.md"
    newest = recorded[-1]
    assert int(newest["failed"]) == 0 < int(newest["passed"])
    assert newest["card"] not in ("", "none")
