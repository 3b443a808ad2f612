"""Show that the tests catch known faults: inject each of faults.yaml into a copy of the checkout.

python tests/faults.py                # all of them, one at a time
python tests/faults.py ppo.py envs/   # those of files whose names contain a word
python tests/faults.py --twentieth 22 # every twentieth, from the third on (22 = 20 + 2)
"""

import argparse
import compileall
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib import import_module
from pathlib import Path
from py_compile import PycInvalidationMode

import pytest
import yaml

TESTS = Path(__file__).parent
OPTIONS = ["-p", "no:cacheprovider", "-o", "addopts=", "-x", "-q", "--tb=line", "-m", "not long"]
# what tests import of other packages, once for all forked processes
SLOW_IMPORTS = (
    "gymnasium matplotlib.figure moocore mujoco_warp PIL.Image pydantic rich.live torch tyro"
)


def occurrences(fault: dict[str, str], checkout: Path) -> int:
    """Return how often the file has the text that the fault replaces, which should be once."""
    path = checkout / fault["file"]
    return path.read_text().count(fault["old"]) if path.is_file() else 0


def read() -> list[dict[str, str]]:
    return yaml.safe_load((TESTS / "faults.yaml").read_text())


def chosen(
    every: list[dict[str, str]], words: list[str], twentieth: int | None
) -> list[dict[str, str]]:
    part = every if twentieth is None else every[twentieth % 20 :: 20]
    return [f for f in part if not words or any(word in f["file"] for word in words)]


def outcome(fault: dict[str, str], checkout: Path) -> str:
    """Inject one fault, run its tests, and take it out again."""
    if (count := occurrences(fault, checkout)) != 1:
        return f"STALE: the file has the text {count} times"
    path = checkout / fault["file"]
    text = path.read_text()
    path.write_text(text.replace(fault["old"], fault["new"]))
    child = os.fork()
    if not child:  # with torch and others already imported
        try:
            run(fault["tests"], checkout)
        finally:
            os._exit(9)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    path.write_text(text)
    return {0: "MISSED", 1: "caught"}.get(status, f"BROKEN: pytest exits with {status}")


def run(tests: str, checkout: Path) -> None:
    """Run a selection in this process, which ends with pytest's status."""
    os.chdir(checkout)
    sys.path.insert(0, str(checkout))
    os.environ["PYTHONPATH"] = str(checkout)
    with open(checkout / "output.txt", "w") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    os._exit(int(pytest.main([*OPTIONS, *shlex.split(tests)])))


def copy_checkout(folder: Path) -> None:
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.check_output(listed, cwd=TESTS.parent, text=True).split("\0")
    for name in filter(None, names):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (TESTS.parent / name).is_file():
            shutil.copy2(TESTS.parent / name, target)
    # by date, a fault of the same size and second would go unnoticed
    by_contents = PycInvalidationMode.CHECKED_HASH
    for part in ("envs", "morlax_torch"):
        compileall.compile_dir(folder / part, quiet=1, invalidation_mode=by_contents)


def main() -> int:
    about = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=about)
    parser.add_argument("words", nargs="*", help="parts of the names of the files with faults")
    said = "inject a twentieth, the K-th modulo 20"
    parser.add_argument("--twentieth", type=int, metavar="K", help=said)
    arguments = parser.parse_args()
    every = read()
    faults = chosen(every, arguments.words, arguments.twentieth)
    # those outside the twentieth too: a change that makes a fault stale fails at once
    stale = [f for f in every if f not in faults and occurrences(f, TESTS.parent) != 1]
    for fault in stale:
        print(f"STALE  {fault['file']}: {fault['old']}", flush=True)
    for name, value in (("OMP_NUM_THREADS", "1"), ("TRITON_INTERPRET", "1")):
        os.environ.setdefault(name, value)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    for name in SLOW_IMPORTS.split():
        import_module(name)
    found = Counter()
    with tempfile.TemporaryDirectory() as folder:
        copy_checkout(Path(folder))
        for fault in faults:
            start = time.perf_counter()
            result = outcome(fault, Path(folder))
            found[result] += 1
            seconds = time.perf_counter() - start
            print(f"{result}  {seconds:.0f} s  {fault['file']}: {fault['old']}", flush=True)
            if result != "caught":
                print(f"    pytest {fault['tests']}", flush=True)
    which = (
        "" if arguments.twentieth is None else f" (twentieth {arguments.twentieth % 20} of 0 to 19)"
    )
    print(f"{found['caught']} of {len(faults)} faults are caught{which}, {len(stale)} others stale")
    return int(found["caught"] < len(faults) or bool(stale))


if __name__ == "__main__":
    sys.exit(main())
