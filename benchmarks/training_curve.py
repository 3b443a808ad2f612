"""Train for a fixed time with regular evaluations, for `table1`."""

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from morlax_torch import MORLAX, MorlaxError
from morlax_torch.config import Config
from morlax_torch.config_files import write_yaml
from morlax_torch.evaluation.evaluator import Protocol
from morlax_torch.runs.training import Limits, make_evaluator, make_worlds, training
from morlax_torch.terminal.cli import console

TARGETS = {  # HYPER-MORL's maximum and the paper's MORLAX maximum, from its Table I
    "cheetah": (5.58e6, 5.78e6),
    "walker": (5.28e6, 6.48e6),
    "ant": (2.70e7, 2.81e7),
    "hopper": (6.0e6, 1.48e7),
    "humanoid": (0.74e6, 5.45e6),
}


class Point(NamedTuple):
    """One evaluation."""

    train_seconds: float  # exploring and learning, without evaluations
    total_seconds: float  # compiling and evaluating included
    env_steps: int
    hypervolume: dict[str, float]  # by protocol
    command_seconds: float | None = None  # of a command that ends at this training time


def training_curve(
    config: Config, seconds: float, every: float, protocols: Sequence[Protocol] = ("latched",)
) -> list[Point]:
    """Train for `seconds` and evaluate after every `every` seconds of training.

    If training fails, for example because a loss is not finite, the curve ends early.

    Args:
        config: the run's config.
        seconds: training time.
        every: training seconds between evaluations.
        protocols: evaluation protocols; the first one also drives the training loop.

    Raises:
        MorlaxError: training fails before the first evaluation.
    """
    learner = MORLAX(make_worlds(config, config.worlds), config)
    first, *others = (make_evaluator(learner, protocol) for protocol in protocols)
    for evaluator in others:
        evaluator.compile()
    points = []
    try:
        for found in training(learner, first, Limits(None, seconds, evaluate_seconds=every)):
            if found.iteration:
                volumes = [found.hypervolume, *(e.evaluate().hypervolume for e in others)]
                by_protocol = dict(zip(protocols, volumes, strict=True))
                point = found.train_seconds, found.total_seconds, found.env_steps, by_protocol
                points.append(Point(*point))
    except MorlaxError as error:
        if not points:
            raise
        console.print(f"stopped early: {error}")
    return points


def command_seconds(config: Config, seconds: float) -> float:
    """Return how long `python -m morlax_torch.train` takes for `seconds` of training.

    It evaluates as it does by default: at the start, at the end and in between.
    """
    with TemporaryDirectory() as place:
        file = Path(place) / "config.yaml"
        file.write_text(write_yaml(config))
        options = ("--config", file, "--max-seconds", seconds, "--output", Path(place) / "run")
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "morlax_torch.train", *map(str, options)],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        return time.perf_counter() - start


def reached(points: Sequence[Point], target: float) -> Point | None:
    """Return the first point whose hypervolume reaches `target`, or None."""
    return next((p for p in points if p.hypervolume["latched"] >= target), None)
