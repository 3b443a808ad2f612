"""Show that the tests catch known faults: inject each of faults.yaml into a copy of the checkout.

python tests/faults.py                # all of them, one at a time
python tests/faults.py ppo.py envs/   # those of files whose names contain a word
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
from pathlib import Path
from py_compile import PycInvalidationMode

import pytest
import yaml

TESTS = Path(__file__).parent
OPTIONS = ["-p", "no:xdist", "-p", "no:cacheprovider", "-o", "addopts=", "-x", "-q", "--tb=line"]


def outcome(fault: dict[str, str], checkout: Path) -> str:
    """Inject one fault, run its tests, and take it out again."""
    path = checkout / fault["file"]
    text = path.read_text()
    if text.count(fault["old"]) != 1:
        return f"STALE: the file has the text {text.count(fault['old'])} times"
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
    os._exit(int(pytest.main([*OPTIONS, "-m", "not long", *shlex.split(tests)])))


def main(words: list[str]) -> int:
    faults = yaml.safe_load((TESTS / "faults.yaml").read_text())
    chosen = [f for f in faults if not words or any(word in f["file"] for word in words)]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("TRITON_INTERPRET", "1")
    # the slow imports of tests, once for all forked processes
    import gymnasium  # noqa: F401
    import moocore  # noqa: F401
    import mujoco_warp  # noqa: F401
    import torch  # noqa: F401
    import tyro  # noqa: F401

    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.check_output(listed, cwd=TESTS.parent, text=True).split("\0")
        for name in filter(None, names):
            target = Path(folder, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            if (TESTS.parent / name).is_file():
                shutil.copy2(TESTS.parent / name, target)
        # by date, a fault of the same size and second would go unnoticed
        by_contents = PycInvalidationMode.CHECKED_HASH
        for part in ("envs", "morlax_torch"):
            compileall.compile_dir(Path(folder, part), quiet=1, invalidation_mode=by_contents)
        for fault in chosen:
            start = time.perf_counter()
            found = outcome(fault, Path(folder))
            missed += found != "caught"
            seconds = time.perf_counter() - start
            print(f"{found}  {seconds:.0f} s  {fault['file']}: {fault['old']}", flush=True)
            if found != "caught":
                print(f"    pytest {fault['tests']}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} faults are caught")
    return int(missed > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", help="parts of names of files (none: all files)")
    sys.exit(main(parser.parse_args().words))
