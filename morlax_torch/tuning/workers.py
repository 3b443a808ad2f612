"""Worker processes of a search, each of which runs trials of the same study."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from threading import Thread
from typing import IO

import torch

from .study import Result, Study

PARENT = "MORLAX_TUNE_PARENT"  # set in workers: the process that waits for them
PAUSE = 0.1  # seconds
MARK = "\x1e"  # begins a line of JSON from a worker: [phase, share], or the number of a trial


def is_worker() -> bool:
    return PARENT in os.environ


def is_orphan() -> bool:
    return is_worker() and os.environ[PARENT] != str(os.getppid())


def places(device: torch.device, number: int | None, one_gpu: bool) -> list[str | None]:
    """Return the value of CUDA_VISIBLE_DEVICES for each worker; None: as it is.

    Without a `number`, there is a worker per visible GPU, or one on the CPU. `one_gpu`: the user
    has chosen one of the GPUs.
    """
    if device.type == "cpu" or one_gpu:
        return [None] * (number or 1)
    count = torch.cuda.device_count()
    named = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    gpus = named.split(",")[:count] if named else [str(index) for index in range(count)]
    return [gpus[index % count] for index in range(number or count)]


class Teller:
    """Tells the process that waits for this worker its phases, and which trials are finished."""

    def __init__(self) -> None:
        self._name, self._time = "", 0.0

    def phase(self, name: str, share: float | None) -> None:
        now = time.monotonic()
        if name != self._name or now - self._time >= PAUSE:
            self._name, self._time = name, now
            _tell([name, share])

    def finished(self, study: Study, result: Result) -> None:
        _tell(result.number)


def _tell(value: object) -> None:
    print(f"{MARK}{json.dumps(value)}", flush=True)


def run_workers(
    arguments: Sequence[str],
    visible: Sequence[str | None],
    asked: Callable[[], int],
    on_line: Callable[[int, str], None],
    on_end: Callable[[int, int], None],
) -> list[int]:
    """Run a `tune` for each of the `places` until all have ended; returns their exit statuses.

    `asked` returns the signal that asks to end, which is forwarded once, or 0. `on_line` is called
    with the number of a worker and each line that it prints, `on_end` with the number and status of
    each worker that has ended.
    """
    running = {
        index: subprocess.Popen(
            [sys.executable, "-m", "morlax_torch", "tune", *arguments],
            env=_environment(gpu, len(visible)),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            process_group=0,  # the terminal's Ctrl-C reaches workers through the parent, so once
        )
        for index, gpu in enumerate(visible)
    }
    lines: SimpleQueue[tuple[int, str]] = SimpleQueue()
    for index, process in running.items():
        Thread(target=_read, args=(index, process.stdout, lines), daemon=True).start()
    statuses, forwarded = {}, False
    try:
        while running:
            if (signal := asked()) and not forwarded:
                forwarded = True
                for process in running.values():
                    process.send_signal(signal)
            try:
                on_line(*lines.get(timeout=PAUSE))
            except Empty:  # so the last lines of a worker come before its end
                for index in [i for i, process in running.items() if process.poll() is not None]:
                    statuses[index] = running.pop(index).returncode
                    on_end(index, statuses[index])
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    return [statuses[index] for index in sorted(statuses)]


def _read(index: int, output: IO[str], lines: SimpleQueue[tuple[int, str]]) -> None:
    with output:
        for line in output:
            lines.put((index, line.rstrip("\n")))


def _environment(gpu: str | None, workers: int) -> dict[str, str]:
    threads = str(max(1, (os.cpu_count() or 1) // workers))
    own = {PARENT: str(os.getpid())} | ({} if gpu is None else {"CUDA_VISIBLE_DEVICES": gpu})
    return {"OMP_NUM_THREADS": threads, **os.environ, **own}
