"""Programs in processes of their own."""

import os
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

SERVER = get_context("forkserver")
SERVER.set_forkserver_preload(["torch", "gymnasium", "morlax_torch.train"])


def run_fresh(code: str, folder: Path) -> str:
    """Run code in a folder, in a process that has imported torch and this package alone.

    Returns:
        What the process wrote to standard error if it failed, else an empty string.
    """
    errors = folder / "stderr"
    process = SERVER.Process(target=_execute, args=(code, folder, errors))
    process.start()
    process.join()
    return errors.read_text() or "no message" if process.exitcode else ""


def _execute(code: str, folder: Path, errors: Path) -> None:
    os.chdir(folder)
    with errors.open("w") as file:
        os.dup2(file.fileno(), sys.stderr.fileno())
    exec(code, {"__name__": "__main__"})


def python(*words: object, **options: Any) -> subprocess.CompletedProcess:
    """Run Python with these words on its command line; options are those of `subprocess.run`."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, **options)


def played(folder: object, *options: str) -> str:
    """Play an export in a process that may not import what training needs; return its output."""
    code = (
        "import sys\n"
        "from morlax_torch.__main__ import command\n"
        f"command(['play', {str(folder)!r}, '--episodes', '1', *{options!r}])\n"
        "print('found', {'torch', 'warp', 'mjlab', 'mujoco_warp'} & set(sys.modules))"
    )
    done = python("-c", code)
    assert "found set()" in done.stdout, done.stderr
    return done.stdout
