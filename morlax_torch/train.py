"""Train one hypernetwork to hold a whole Pareto front of policies."""

import math
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch
from torch import nn

from . import cli, envs
from .arguments import read
from .config import Config
from .display import Display
from .envs import MorlaxError, Worlds
from .evaluation import Evaluator
from .morlax import MORLAX
from .run import Progress, Run
from .tradeoffs import evaluation_tradeoffs

REPORT_EVERY = 10  # iterations between looks at the metrics, each of which waits for the GPU


def train(
    config: Config,
    run: Run | None = None,
    output: Path | None = None,
    actor: nn.Module | None = None,
    critic: nn.Module | None = None,
) -> Run:
    """Train until a limit of `config` is reached, or Ctrl-C is pressed; the run's folder.

    Args:
        config: every number of the run.
        run: a run to go on with, instead of a new one.
        output: the folder of a new run (None: runs/<task>/<time>-<seed>).
        actor: instead of the config's own, as `MORLAX` takes it.
        critic: likewise.

    Raises:
        MorlaxError: the folder cannot be written, the simulation's buffers overflow, or a loss
            is no longer finite; the checkpoints stay as they were.
    """
    began = time.perf_counter()
    if torch.cuda.is_available():
        torch.set_float32_matmul_precision("high")  # TF32
    morlax = MORLAX(make_worlds(config, config.worlds), config, actor, critic)
    tradeoffs = evaluation_tradeoffs(config.evaluation.tradeoffs, len(morlax.env.objectives))
    judges = make_worlds(config, len(tradeoffs), judging=True)
    evaluator = Evaluator(morlax.agent, judges, tradeoffs)
    if run is None:
        run, progress = Run.create(morlax, output), Progress()
    else:
        progress = run.restore(morlax)
    before = progress.total_seconds
    interval = max(1, config.evaluation.every // morlax.steps_per_iteration)
    last = math.inf
    if config.max_env_steps is not None:
        last = math.ceil(config.max_env_steps / morlax.steps_per_iteration)
    evaluated = morlax.iteration if run.has_evaluation(morlax.iteration) else None

    with Display(config, morlax.env, run.folder) as display, interruptible() as interrupted:
        if morlax.env.simulator == "MuJoCo Warp":
            display.say("compiling kernels: most of a minute the first time on a machine")
        morlax.compile()
        evaluator.compile()
        while True:
            finished = (
                interrupted()
                or morlax.iteration >= last
                or (config.max_seconds is not None and progress.train_seconds >= config.max_seconds)
            )
            due = morlax.iteration % interval == 0 or (finished and not interrupted())
            if due and evaluated != morlax.iteration:
                front = evaluator.evaluate()
                evaluated = morlax.iteration
                progress.total_seconds = before + time.perf_counter() - began
                row = run.log_evaluation(front, morlax, progress)
                display.evaluated(row)
                run.save(morlax, progress, best=progress.judge(row))
            if finished:
                break
            to_evaluation = interval - morlax.iteration % interval
            most = int(min(REPORT_EVERY, to_evaluation, last - morlax.iteration))
            first, start = morlax.iteration, time.perf_counter()
            for _ in range(most):
                morlax.iterate()
                if interrupted():
                    break
            metrics = morlax.metrics()
            seconds = time.perf_counter() - start
            progress.train_seconds += seconds
            count = morlax.iteration - first
            progress.steps_per_second = count * morlax.steps_per_iteration / seconds
            check(metrics, morlax, run, count)
            run.log_metrics(metrics, morlax, progress)
            display.update(morlax.env_steps, progress)
        progress.total_seconds = before + time.perf_counter() - began
        if interrupted():
            run.save(morlax, progress)
        run.close()
        display.finished(morlax.env_steps, progress, interrupted())
    return run


def make_worlds(config: Config, number: int, judging: bool = False) -> Worlds:
    """The worlds that `config` describes: to train in, or to judge policies in."""
    task = config.task.judged() if judging else config.task
    return envs.make(
        config.env,
        number,
        config.device,
        config.backend,
        config.seed,
        auto_reset=not judging,
        deterministic=config.deterministic,
        **task.model_dump(),
    )


def check(metrics: dict[str, float], morlax: MORLAX, run: Run, count: int) -> None:
    """Raise MorlaxError if the last `count` iterations cannot be trusted."""
    span = f"iterations {morlax.iteration - count + 1} to {morlax.iteration}"
    kept = f"The last good checkpoint is {run.checkpoints / 'latest.pt'}."
    if metrics["overflow"]:
        remedy = morlax.env.remedy(int(metrics["overflow"]))
        raise MorlaxError(f"contacts overflowed their buffers in {span}: {remedy}. {kept}")
    for name in ("policy_loss", "value_loss", "entropy"):
        if not math.isfinite(metrics[name]):
            raise MorlaxError(
                f"the {name.replace('_', ' ')} became {metrics[name]} in {span} "
                f"({metrics['blowups']:.0f} worlds were no longer finite so far): "
                f"try a lower --ppo.learning-rate. {kept}"
            )


@contextmanager
def interruptible() -> Iterator:
    """Turns the first Ctrl-C (or SIGTERM) into a flag; a second one acts as usual."""
    pressed = False

    def press(number: int, frame: object) -> None:
        nonlocal pressed
        pressed = True
        for which, handler in usual.items():
            signal.signal(which, handler)

    usual = {which: signal.signal(which, press) for which in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: pressed
    finally:
        for which, handler in usual.items():
            signal.signal(which, handler)


def command(arguments: Sequence[str]) -> None:
    train(*read(arguments))


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
