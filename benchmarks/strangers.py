"""Time `morlax new` and the training that it proposes, up to the first front after step 0.

python benchmarks/strangers.py benchmarks/results/strangers-cpu.csv ROBOT=FILE.xml ...
"""

import argparse
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from row_files import read_rows, write_rows

LONGEST = 600.0  # seconds to wait for a front
COLUMNS = ["robot", "task", "new_s", "first_front_s", "env_steps", "hypervolume", "before"]


def morlax(folder: Path, *words: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "morlax_torch", *words]
    out = subprocess.PIPE
    return subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT, text=True)


def measured(robot: str, model: Path, folder: Path) -> dict[str, object]:
    """Return a row: the seconds of `new`, those until the first front, and its numbers."""
    began = time.perf_counter()
    new = morlax(folder, "new", str(model.resolve()), "--output", f"{robot}.py")
    written, line, *_ = [*(new.communicate()[0] or "").splitlines(), ""]
    row = {"robot": robot, "new_s": f"{time.perf_counter() - began:.1f}"}
    if not line.startswith("next: "):
        return row | {"task": written.replace(f"{model.resolve().parent}/", "")}
    row["task"] = written.partition("in which ")[2]
    metrics, rows, began = folder / robot / "metrics.csv", [], time.perf_counter()
    training = morlax(folder, "train", *shlex.split(line)[5:], "--output", robot)
    while len(rows) < 2 and training.poll() is None and time.perf_counter() - began < LONGEST:
        time.sleep(0.2)
        rows = read_rows(metrics)
    row["first_front_s"] = f"{time.perf_counter() - began:.1f}"
    training.send_signal(signal.SIGINT)
    said = training.communicate()[0]
    if len(rows) < 2:
        return row | {"task": said.splitlines()[-1]}
    return row | {name: rows[1][name] for name in COLUMNS[4:-1]} | {"before": rows[0][COLUMNS[5]]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("robots", nargs="+", help="ROBOT=FILE.xml")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for robot, _, model in (each.partition("=") for each in options.robots):
            rows.append(measured(robot, Path(model), Path(folder)))
            write_rows(options.output, rows, COLUMNS)
            print(rows[-1], flush=True)


if __name__ == "__main__":
    main()
