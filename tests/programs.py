"""Programs in processes of their own."""

import subprocess
import sys
from typing import Any


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
