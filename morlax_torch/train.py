"""Train one hypernetwork to hold a whole Pareto front of policies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple

from .config import Config
from .envs import MorlaxError
from .files import AnyPath
from .terminal import cli
from .terminal.arguments import read
from .terminal.clock import command_began
from .terminal.interrupt import interruptible

if TYPE_CHECKING:  # torch takes seconds to import: not before the command line is read
    from torch import nn

    from .algorithms.learner import Learner
    from .evaluation.evaluator import Evaluator
    from .gpu.group import Group
    from .runs.progress import Evaluation, Progress
    from .runs.run import Run


def train(
    config: Config,
    run: Run | None = None,
    output: AnyPath | None = None,
    actor: nn.Module | None = None,
    critic: nn.Module | None = None,
    *,
    on_evaluation: Callable[[Evaluation], None] | None = None,
) -> Run:
    """Train until a limit of `config` is reached; returns the run.

    It prints nothing and installs no signal handlers, so it works in threads, notebooks and
    tuners. An exception from `on_evaluation` ends training; the run can be resumed. Started by
    `torchrun`, all processes train together, and the first one writes the run.

    Args:
        config: every number of the run.
        run: a run to resume, instead of a new one.
        output: folder of a new run (None: runs/<task>/<time>-<seed>).
        actor: replaces the config's actor, see `MORLAX`.
        critic: replaces the config's critic, see `MORLAX`.
        on_evaluation: called with each evaluation once it is written; training may be ahead of it.
            Of several processes, each calls its own.

    Raises:
        MorlaxError: the folder cannot be written, the simulator's buffers overflow, every world
            blows up, or a loss is not finite. Checkpoints keep their last good state.
    """
    began = time.perf_counter()
    session = _prepare(config, run, output, actor, critic)
    with closing(session.train(began)) as evaluations:
        for evaluation in evaluations:
            if on_evaluation is not None:
                on_evaluation(evaluation)
    return session.run


class _Session(NamedTuple):
    """A run that is ready to train; the first process writes it."""

    learner: Learner
    evaluator: Evaluator
    run: Run
    progress: Progress

    def train(
        self, began: float, stopped: Callable[[], bool] = lambda: False
    ) -> Generator[Evaluation, None, None]:
        from .runs.training import training

        run = self.run if self.learner.group.rank == 0 else None
        return training(self.learner, self.evaluator, run, self.progress, began, stopped=stopped)


def _prepare(
    config: Config,
    run: Run | None,
    output: AnyPath | None,
    actor: nn.Module | None = None,
    critic: nn.Module | None = None,
) -> _Session:
    from .algorithms.registry import make_learner
    from .gpu.group import join
    from .runs.progress import Progress
    from .runs.run import Run
    from .runs.starting import start_from
    from .runs.training import make_evaluator, make_worlds

    config, group = join(config)
    run = _shared(run, group)
    worlds = make_worlds(config, config.worlds, group.rank)
    learner = make_learner(worlds, config, actor, critic, group=group)
    evaluator = make_evaluator(learner)
    if config.start_from is not None and run is None:
        start_from(config.start_from, learner)
    if run is not None:
        return _Session(learner, evaluator, run, run.restore(learner))
    return _Session(learner, evaluator, Run.create(learner, output), Progress())


def _shared(run: Run | None, group: Group) -> Run | None:
    """Return the run to go on with, if the first process has one.

    Raises:
        MorlaxError: it has one, and this process does not find it.
    """
    if not group.first(run is not None):
        return None  # this host may have an older folder of that name
    if run is None:
        raise MorlaxError(
            f"process 0 goes on with a run that process {group.rank} does not find: put its folder "
            "on a disk that all hosts share."
        )
    return run


def command(arguments: Sequence[str]) -> None:
    began = command_began()
    config, run, output = read(arguments)
    if run is not None and (limit := run.limit_reached(config)):
        cli.console.print(
            f"{run.folder} has reached its limit: raise --{limit} to train it further."
        )
        return
    from .terminal.display import Display

    session = _prepare(config, run, output)
    gather = session.learner.group.gather

    def stopped() -> bool:
        if received := max(gather(interrupted.signal)):
            interrupted.signal = received  # a signal to one process ends all
        return received > 0

    with (
        interruptible() as interrupted,
        Display(session.learner, session.run.folder, session.progress) as display,
        closing(session.train(began, stopped)) as evaluations,
    ):
        for evaluation in evaluations:
            display.evaluated(evaluation)
        display.finished(interrupted())
    if interrupted():
        sys.exit(interrupted.exit_status)


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
