"""Train one hypernetwork to hold a whole Pareto front of policies."""

import argparse
import math
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch
from pydantic import create_model

from . import cli, envs
from .config import Config, Section, config_class, file_values, load_config, merged, task_values
from .display import Display
from .envs import Environment, MorlaxError
from .evaluation import Evaluator
from .morlax import MORLAX
from .run import Progress, Run
from .tradeoffs import evaluation_tradeoffs

REPORT_EVERY = 10  # iterations between looks at the metrics, each of which waits for the GPU
MAY_CHANGE_ON_RESUME = ("max_env_steps", "max_seconds", "device", "backend")


def train(config: Config, run: Run | None = None, output: Path | None = None) -> Run:
    """Train until a limit of `config` is reached, or Ctrl-C is pressed; the run's folder.

    Args:
        config: every number of the run.
        run: a run to go on with, instead of a new one.
        output: the folder of a new run (None: runs/<task>/<time>-<seed>).

    Raises:
        MorlaxError: the folder cannot be written, the simulation's buffers overflow, or a loss
            is no longer finite; the checkpoints stay as they were.
    """
    began = time.perf_counter()
    if torch.cuda.is_available():
        torch.set_float32_matmul_precision("high")  # TF32
    morlax = MORLAX(make_worlds(config, config.worlds), config)
    tradeoffs = evaluation_tradeoffs(config.evaluation.tradeoffs, len(morlax.env.objectives))
    judges = make_worlds(config, len(tradeoffs), auto_reset=False)
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
        if morlax.env.physics.name == "MuJoCo Warp":
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
                best = progress.judge(front.hypervolume)
                display.evaluated(run.log_evaluation(front, morlax, progress))
                run.save(morlax, progress, best)
            if finished:
                break
            to_evaluation = interval - morlax.iteration % interval
            count = int(min(REPORT_EVERY, to_evaluation, last - morlax.iteration))
            start = time.perf_counter()
            for _ in range(count):
                morlax.iterate()
            metrics = morlax.metrics()
            seconds = time.perf_counter() - start
            progress.train_seconds += seconds
            progress.steps_per_second = count * morlax.steps_per_iteration / seconds
            check(metrics, morlax, run, count)
            run.log_metrics(metrics, morlax, progress)
            display.update(morlax.env_steps, progress)
        progress.total_seconds = before + time.perf_counter() - began
        run.save(morlax, progress)
        run.close()
        display.finished(morlax.env_steps, progress, interrupted())
    return run


def make_worlds(config: Config, number: int, auto_reset: bool = True) -> Environment:
    """The worlds that `config` describes."""
    return envs.make(
        config.env,
        number,
        config.device,
        config.backend,
        config.seed,
        auto_reset=auto_reset,
        deterministic=config.deterministic,
        **config.task.model_dump(),
    )


def check(metrics: dict[str, float], morlax: MORLAX, run: Run, count: int) -> None:
    """Raise MorlaxError if the last `count` iterations cannot be trusted."""
    span = f"iterations {morlax.iteration - count + 1} to {morlax.iteration}"
    kept = f"The last good checkpoint is {run.checkpoints / 'latest.pt'}."
    if metrics["overflow"]:
        remedy = morlax.env.physics.remedy(int(metrics["overflow"]))
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


class Command(Section):
    config: Path | None = None
    """A YAML file with what differs from the task's own config."""
    output: Path | None = None
    """The run's folder (None: runs/<task>/<time>-<seed>)."""
    resume: Path | None = None
    """Go on with the run in this folder; only limits and device may change."""


def read(arguments: Sequence[str]) -> tuple[Config, Run | None, Path | None]:
    """The command line over the config that it names: file, task or an earlier run's."""
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name in ("--env", "--config", "--resume", "--device"):
        first.add_argument(name)
    early = first.parse_known_args(arguments)[0]
    run = Run.open(Path(early.resume)) if early.resume else None
    below = run.config() if run else load_config(_values(early, arguments))
    model = create_model("Train", __base__=(Command, config_class(below.env)))
    about = f"{__doc__} The defaults below are those of --env {below.env}, from configs/."
    default = model.model_validate(below.model_dump())
    values = cli.parse(default, arguments, "python -m morlax_torch.train", about)
    own = {name: values.pop(name) for name in Command.model_fields}
    place = envs.resolve_device(values["device"])
    moved = run is not None and str(place) != below.device
    if values["backend"] is None or (moved and values["backend"] == below.backend):
        values["backend"] = "warp" if place.type == "cuda" else "mujoco"
    config = load_config({**values, "device": str(place)})
    if run is not None:
        for name, value in below.model_dump().items():
            if name not in MAY_CHANGE_ON_RESUME and config.model_dump()[name] != value:
                raise MorlaxError(
                    f"{name} cannot change when a run is resumed: leave it out, or start a new "
                    f"run. Only {', '.join(MAY_CHANGE_ON_RESUME)} may."
                )
    return config, run, own["output"]


def _values(early: argparse.Namespace, arguments: Sequence[str]) -> dict:
    device_type = envs.resolve_device(early.device).type
    if early.config is None:
        if early.env is None and not {"-h", "--help"} & set(arguments):
            raise MorlaxError(f"say which task to train: --env NAME, of {', '.join(envs.names())}.")
        return task_values(early.env or "cheetah", device_type)
    values = file_values(Path(early.config), device_type)
    if early.env is None:
        return values
    if values.setdefault("env", early.env) != early.env:
        raise MorlaxError(
            f"{early.config} is for env {values['env']!r}, but --env says {early.env!r}."
        )
    return merged(task_values(early.env, device_type), values)


def command(arguments: Sequence[str]) -> None:
    train(*read(arguments))


def main() -> None:
    cli.run(command)


if __name__ == "__main__":
    main()
