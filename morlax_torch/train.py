"""Train one hypernetwork to hold a whole Pareto front of policies."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # torch takes seconds to import: not before the command line is read
    from torch import nn

    from .configuration.config import Config
    from .host.files import AnyPath
    from .runs.progress import Evaluation
    from .runs.run import Run


def train(
    config: Config,
    run: Run | None = None,
    output: AnyPath | None = None,
    actor: nn.Module | None = None,
    critic: nn.Module | None = None,
    *,
    on_evaluation: Callable[[Evaluation], None] | None = None,
    on_metrics: Callable[[dict[str, float], int], object] | None = None,
) -> Run:
    """Train until a limit of `config` is reached; returns the run.

    It prints nothing and installs no signal handlers, so it works in threads, notebooks and
    tuners. An exception from a callback ends training; the run can be resumed. Started by
    `torchrun`, all processes train together, and the first one writes the run; each calls its own
    callbacks.

    Args:
        config: every number of the run.
        run: a run to resume, instead of a new one. Only limits, target, evaluation, device and
            backend may differ from those of `run.config()`.
        output: folder of a new run (None: runs/<task>/<time>-<seed>).
        actor: replaces the config's actor, see `MORLAX`.
        critic: replaces the config's critic, see `MORLAX`.
        on_evaluation: called with each evaluation once it is written; training may be ahead of it.
        on_metrics: called with new points of TensorBoard's curves, by tag, and environment steps,
            as `mlflow.log_metrics` is. Steps fall back where training was ahead of an evaluation.

    Raises:
        MorlaxError: the folder cannot be written, the simulator's buffers overflow, every world
            blows up, or a loss is not finite. Checkpoints keep their last good state.
    """
    from .runs.training import Session

    began = time.perf_counter()
    session = Session.of(config, run, output, actor, critic)
    session.on_metrics = on_metrics or session.on_metrics
    with closing(session.training(began)) as evaluations:
        for evaluation in evaluations:
            session.on_metrics(evaluation.scalars, evaluation.env_steps)
            if on_evaluation is not None:
                on_evaluation(evaluation)
    assert session.run is not None
    return session.run


if __name__ == "__main__":
    from .commands.terminal import cli
    from .commands.train import command

    cli.run(command)
