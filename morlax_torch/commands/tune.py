"""Search for a task's hyperparameters."""

import json
import math
import shlex
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..envs import MorlaxError
from ..host.phases import heard_by
from ..host.torchrun import SEVERAL
from .terminal import cli
from .terminal.live import Live
from .terminal.process import Interruption, interruptible, program
from .terminal.tune_arguments import read

if TYPE_CHECKING:
    from .terminal.tune_display import TuneDisplay


def command(arguments: Sequence[str]) -> None:
    if SEVERAL:
        raise MorlaxError("tune has --workers of its own: start it without torchrun.")
    config, options, one_gpu = read(arguments)
    from ..envs import resolve_device  # imports torch
    from ..tuning import workers
    from ..tuning.results import write_results
    from ..tuning.searching import folder_of, open_study, search
    from .terminal.tune_display import TuneDisplay

    folder = folder_of(config, options.output)
    study = open_study(
        config,
        options.space,
        options.output,
        options.seconds,
        options.indicators,
        options.storage,
        options.study,
    )
    display = TuneDisplay(study, folder, options.trials)
    end = time.monotonic() + 60 * (options.minutes or math.inf)

    def stopped() -> bool:
        return interrupted() or workers.is_orphan() or time.monotonic() >= end

    with interruptible() as interrupted:
        if workers.is_worker():
            teller = workers.Teller()
            with heard_by(teller.phase):
                search(study, folder, options.trials, stopped, teller.finished)
        else:
            visible = workers.places(resolve_device(config.device), options.workers, one_gpu)
            several = len(visible) > 1
            write_results(study, folder)  # a folder that cannot be written is told before training
            display.started(f"{len(visible)} workers" if several else str(config.device))
            if several:
                _search_together(arguments, visible, display, interrupted)
                write_results(study, folder)
            else:
                with Live():
                    search(study, folder, options.trials, stopped, display.finished)
            display.ended(f"{program('tune')} {shlex.join(arguments)}")
            results = study.results()
            if results and all(result.state == "failed" for result in results):
                last = results[-1].reason
                raise MorlaxError(f"every trial failed, the last one because: {last}")
    if interrupted():
        sys.exit(interrupted.exit_status)


def _search_together(
    arguments: Sequence[str],
    visible: Sequence[str | None],
    display: "TuneDisplay",
    interrupted: Interruption,
) -> None:
    from ..tuning.workers import MARK, run_workers

    def printed(index: int, line: str) -> None:
        if not line.startswith(MARK):
            print(line, file=sys.stderr)  # an error or a warning
            return
        told = json.loads(line[len(MARK) :])
        if isinstance(told, int):
            display.finished_by_worker(told)
        else:
            live.show(*told, row=index)

    def ended(index: int, status: int) -> None:
        if status and not interrupted():
            cli.console.print(
                f"worker {index} ended with status {status}; its trial is queued again"
            )

    with Live(len(visible)) as live:
        statuses = run_workers(arguments, visible, lambda: interrupted.signal, printed, ended)
    if all(statuses) and not interrupted():
        raise MorlaxError(f"all {len(statuses)} workers ended early: see the lines above.")
