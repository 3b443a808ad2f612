"""Options of pytest: how many tests a run may skip, and a record of runs on a GPU."""

import csv
import os
import subprocess
from collections import Counter
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import pytest

COLUMNS = (
    *("date", "commit", "card", "cards", "torch", "warp-lang", "mujoco", "mujoco-warp"),
    *("passed", "failed", "skipped"),
)


def pytest_addoption(parser: pytest.Parser) -> None:
    about = "fail unless exactly this many tests are skipped; -rs lists them"
    parser.addoption("--skips", type=int, metavar="N", help=about)
    about = "append commit, card, versions and outcome to this CSV file (COMMIT names the commit)"
    parser.addoption("--record-gpu", type=Path, metavar="FILE", help=about)


def pytest_configure(config: pytest.Config) -> None:
    if config.option.record_gpu and not counts(config):
        commit()  # says now what is missing, not after the tests


def pytest_sessionfinish(session: pytest.Session) -> None:
    config = session.config
    number = counts(config)
    if number and config.option.record_gpu:
        record(config.option.record_gpu, number)
    if number and config.option.skips not in (None, number["skipped"]):
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    config = terminalreporter.config
    skipped = counts(config)["skipped"]
    if config.option.skips not in (None, skipped):
        line = f"ERROR: {skipped} tests were skipped instead of {config.option.skips}"
        terminalreporter.write_line(line, red=True)


def counts(config: pytest.Config) -> dict[str, int]:
    """Return how many tests passed, failed and were skipped; empty in a worker of xdist."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or hasattr(config, "workerinput"):
        return {}
    number = Counter({kind: len(reports) for kind, reports in reporter.stats.items()})
    failed = number["failed"] + number["error"]
    return {"passed": number["passed"], "failed": failed, "skipped": number["skipped"]}


def commit() -> str:
    """Return the commit of the checkout, or the one that COMMIT names on a host without git."""
    if named := os.environ.get("COMMIT"):
        return named
    command = ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True)
    except FileNotFoundError:
        done = None
    if done is None or done.returncode:
        raise pytest.UsageError("git does not tell the commit: set COMMIT=... for --record-gpu")
    return done.stdout.strip()


def record(path: Path, number: dict[str, int]) -> None:
    import torch

    row = {
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "card": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "cards": torch.cuda.device_count(),
        **{name: version(name) for name in COLUMNS[4:8]},
        **number,
    }
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)
