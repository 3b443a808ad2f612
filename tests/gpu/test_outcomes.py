"""Options of the tests themselves, and the record of their runs on a GPU."""

from datetime import date
from functools import partial
from pathlib import Path

import pytest
from same import csv_rows

pytest_plugins = "pytester"
RECORD = Path(__file__).parents[1] / "gpu_runs.csv"
TESTS = """
import pytest

def test_passes():
    pass

@pytest.mark.skip("no telescope")
def test_skipped():
    pass

def test_chosen():
    pytest.skip("no star")
"""


def test_another_number_of_skipped_tests_is_a_failure(pytester):
    pytester.makepyfile(TESTS)
    run = partial(pytester.runpytest_inprocess, "-p", "no:xdist", "-p", "outcomes", "-rs")
    run().stdout.fnmatch_lines(["*no telescope*", "*no star*"])
    for number in "1", "3":
        result = run("--skips", number)
        assert result.ret == pytest.ExitCode.TESTS_FAILED
        result.stdout.fnmatch_lines(f"ERROR: 2 tests were skipped instead of {number}")
    for options in ((), ("--skips", "2")):  # without the option any number is right
        result = run(*options)
        assert result.ret == 0
        result.stdout.no_fnmatch_line("ERROR: *")


def test_the_last_run_on_a_gpu_had_no_failure():
    recorded = csv_rows(RECORD)
    assert all(date.fromisoformat(row["date"]) for row in recorded)
    assert recorded, "run the GPU tests with --record-gpu tests/gpu_runs.csv, see CONTRIBUTING.md"
    newest = recorded[-1]
    assert int(newest["failed"]) == 0 < int(newest["passed"])
    assert newest["card"] not in ("", "none")
