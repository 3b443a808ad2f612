"""Train a run in the terminal."""

import os
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from ..envs import MorlaxError
from ..envs.making import has_robot
from ..host.torchrun import FIRST
from .explore import BESIDE
from .terminal import cli
from .terminal.arguments import read
from .terminal.process import BEGAN, interruptible, is_command


def command(arguments: Sequence[str]) -> None:
    began = time.perf_counter()
    if is_command():
        began = BEGAN
        if not {"-h", "--help"} & set(arguments):  # importing torch takes seconds
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
            _check_page(config.env)
        session = Session.of(config, run, start.output)
    assert session.run is not None
    gather, ended = session.learner.group.gather, False

    def stopped() -> bool:
        nonlocal ended
        if received := max(gather(interrupted.signal)):
            interrupted.signal = received  # a signal to one process ends all
            ended = True  # a later signal finds a run that has reached its limit
        return ended

    with interruptible() as interrupted, ExitStack() as stack:
        page = stack.enter_context(_page(session.run.folder)) if start.explore and FIRST else None
        with (
            Display(session.learner, session.run.folder, session.progress) as display,
            closing(session.training(began, stopped=stopped)) as evaluations,
        ):
            for evaluation in evaluations:
                display.evaluated(evaluation)
            display.finished(ended)
        if page is not None and not ended and page.poll() is None:
            cli.console.print("the page stays open  (Ctrl-C to stop)")
            while page.poll() is None and not interrupted():
                time.sleep(0.1)
    if ended:
        interrupted.exit()


def _check_page(env: str) -> None:
    """Raise MorlaxError if a page cannot be served, or has no robot to show."""
    from ..viewers.explorer.page import files

    if not has_robot(env):
        raise MorlaxError(f"{env} has no MuJoCo robot to show: leave out --explore.")
    files()


@contextmanager
def _page(run: Path) -> Iterator[subprocess.Popen]:
    """Show a run in another process, on the CPU and behind training, while the block runs."""
    process = subprocess.Popen(
        [sys.executable, "-m", "morlax_torch", "explore", str(run), "--trust"],
        env={**os.environ, BESIDE: str(os.getpid()), "WORLD_SIZE": "1", "CUDA_VISIBLE_DEVICES": ""},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,  # Ctrl-C is for training
    )

    with process as page:

        def tell() -> None:  # what the page prints, without breaking the moving bar
            for line in page.stdout or ():
                cli.console.print(line.rstrip().removesuffix("  (Ctrl-C to stop)"), soft_wrap=True)

        threading.Thread(target=tell, daemon=True).start()
        try:
            yield page
        finally:
            page.terminate()


def main() -> None:
    cli.run(command)
