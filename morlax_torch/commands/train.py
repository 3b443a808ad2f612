"""Train a run in the terminal."""

import shlex
import time
from collections.abc import Sequence
from contextlib import closing

from .terminal import cli
from .terminal.arguments import read
from .terminal.process import BEGAN, interruptible, is_command


def command(arguments: Sequence[str]) -> None:
    began = time.perf_counter()
    if is_command():
        began = BEGAN
        if not {"-h", "--help"} & set(arguments):  # importing torch takes seconds
            cli.console.print(f"starting: train {shlex.join(arguments)}")
    config, run, output = read(arguments)
    if run is not None and (limit := run.limit_reached(config)):
        cli.console.print(
            f"{run.folder} has reached its limit: raise --{limit} to train it further."
        )
        return
    with cli.Live():
        from ..runs.training import Session  # imports torch
        from .terminal.display import Display

        session = Session.of(config, run, output)
    assert session.run is not None
    gather, ended = session.learner.group.gather, False

    def stopped() -> bool:
        nonlocal ended
        if received := max(gather(interrupted.signal)):
            interrupted.signal = received  # a signal to one process ends all
            ended = True  # a later signal finds a run that has reached its limit
        return ended

    with (
        interruptible() as interrupted,
        Display(session.learner, session.run.folder, session.progress) as display,
        closing(session.training(began, stopped=stopped)) as evaluations,
    ):
        for evaluation in evaluations:
            display.evaluated(evaluation)
        display.finished(ended)
    if ended:
        interrupted.exit()


def main() -> None:
    cli.run(command)
