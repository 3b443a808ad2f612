"""Train a run in the terminal."""

import gc
import os
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from ..host.torchrun import FIRST
from .explore import BESIDE
from .terminal import cli
from .terminal.arguments import read
from .terminal.process import BEGAN, interruptible, is_command


def command(arguments: Sequence[str]) -> None:
    began = BEGAN if is_command() else time.perf_counter()
    if is_command() and not {"-h", "--help"} & set(arguments):  # importing torch takes seconds
        cli.console.print(f"starting: train {shlex.join(arguments)}")
    config, run, start = read(arguments)
    if run is not None and (limit := run.limit_reached(config)):
        cli.console.print(
            f"{run.folder} has reached its limit: raise --{limit} to train it further."
        )
        return
    with cli.Live():
        from ..runs.training import Session  # imports torch
        from .terminal.display import Display

        if start.explore:
            from ..viewers.explorer.page import files

            files()  # refuses without the extra
        session = Session.of(config, run, start.output)
        gc.freeze()  # else collections, which stop training, would look through all libraries
    assert session.run is not None
    gather, ended = session.learner.group.gather, 0

    def stopped() -> bool:
        nonlocal ended  # by this signal; a later one finds a run that has reached its limit
        ended = ended or max(gather(max(received, default=0)))  # a signal to one process ends all
        return ended > 0

    with interruptible() as received:
        page = _page(session.run.folder) if start.explore and FIRST else None
        with (
            Display(session.learner, session.run.folder, session.progress) as display,
            closing(session.training(began, stopped=stopped)) as evaluations,
        ):
            for evaluation in evaluations:
                display.evaluated(evaluation)
            display.finished(ended > 0)
        if page is not None and not ended and page.poll() is None:
            cli.console.print("the page stays open  (Ctrl-C to stop)")
            while page.poll() is None and not received:
                time.sleep(0.1)
    if ended:
        sys.exit(128 + ended)  # as a program that the signal ended


def _page(run: Path) -> subprocess.Popen:
    """Show a run in another process, on the CPU, until this one ends; return that process."""
    words = sys.executable, "-m", "morlax_torch", "explore", str(run), "--trust"
    env = {**os.environ, BESIDE: str(os.getpid()), "WORLD_SIZE": "1", "CUDA_VISIBLE_DEVICES": ""}
    pipe = subprocess.PIPE
    page = subprocess.Popen(words, env=env, stdout=pipe, stderr=subprocess.STDOUT, text=True)

    def tell() -> None:  # without breaking the moving bar
        for line in page.stdout or ():
            cli.console.print(line.rstrip().removesuffix("  (Ctrl-C to stop)"), soft_wrap=True)

    threading.Thread(target=tell, daemon=True).start()
    return page
