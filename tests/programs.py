"""Programs in processes of their own."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

SERVER = get_context("forkserver")
# libraries that take seconds to import; this package reads the environment when it is imported
SERVER.set_forkserver_preload(["torch._dynamo", "gymnasium", "mujoco", "matplotlib.figure"])


class Program:
    """Code that runs in a process which has imported torch and a few other libraries already.

    Args:
        code: as `python -c` takes it.
        folder: where it runs, and writes its output to the files `stdout` and `stderr`.
        words: those after the program's name in `sys.argv`.
        variables: of its environment, beside those of this process.
    """

    def __init__(self, code: str, folder: Path, words: Sequence[str] = (), **variables: str):
        folder.mkdir(exist_ok=True)
        self._folder = folder
        arguments = code, folder, words, {**os.environ, **variables}
        self._process = SERVER.Process(target=_execute, args=arguments)
        self._process.start()

    def poll(self) -> int | None:
        """Return the exit status, or None if the program still runs."""
        return self._process.exitcode

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def send_signal(self, number: signal.Signals) -> None:
        os.kill(self._process.pid or 0, number)

    def kill(self) -> None:
        """End the program at once, if it still runs."""
        self._process.kill()
        self._process.join()

    def printed(self) -> list[str]:
        """Return the whole lines that are on stdout so far."""
        file = self._folder / "stdout"
        lines = file.read_text().splitlines(keepends=True) if file.exists() else []
        return [line for line in lines if line.endswith("\n")]

    def ended(self, seconds: float | None = None) -> tuple[int, str, str]:
        """Wait for the end; return exit status and what was written to stdout and to stderr."""
        self._process.join(seconds)
        status = self._process.exitcode
        assert status is not None, f"the program still runs after {seconds} s"
        output, errors = ((self._folder / name).read_text() for name in ("stdout", "stderr"))
        return status, output, errors


def _execute(code: str, folder: Path, words: Sequence[str], variables: dict[str, str]) -> None:
    os.chdir(folder)
    os.environ.update(variables)
    sys.argv = ["-c", *words]
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        with open(name, "w") as file:
            os.dup2(file.fileno(), descriptor)
    exec(code, {"__name__": "__main__"})


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def start(code: str, folder: Path, rank: int, port: int, words: Sequence[str] = ()) -> Program:
    """Start one of two processes as `torchrun` does, in a folder of its own."""
    places = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2"}
    ranks = {"RANK": str(rank), "LOCAL_RANK": str(rank)}
    return Program(code, folder / f"process-{rank}", words, **places, **ranks)


def start_both(code: str, folder: Path, words: Sequence[str] = ()) -> list[Program]:
    port = free_port()
    return [start(code, folder, rank, port, words) for rank in range(2)]


def ended(programs: Sequence[Program], seconds: float = 100.0) -> tuple[list[int], str, str]:
    """Wait for programs; return their exit statuses, and all that they wrote."""
    statuses, outputs, errors = zip(*(each.ended(seconds) for each in programs), strict=True)
    return list(statuses), "".join(outputs), "".join(errors)


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
