"""Train for some seconds and judge the front now and then; what `search` and `table1` share."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch

from morlax_torch import MORLAX
from morlax_torch.config import Config, load_config, merged, task_values
from morlax_torch.evaluation.evaluator import Evaluator, Protocol
from morlax_torch.runs.training import make_worlds
from morlax_torch.tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs

TARGETS = {  # HYPER-MORL's maximum and the paper's MORLAX maximum, of its Table I
    "cheetah": (5.58e6, 5.78e6),
    "walker": (5.28e6, 6.48e6),
    "ant": (2.70e7, 2.81e7),
    "hopper": (6.0e6, 1.48e7),
    "humanoid": (0.74e6, 5.45e6),
}
AHEAD = 4  # iterations that may be launched before the GPU is waited for


class Point(NamedTuple):
    """An evaluation."""

    train_seconds: float  # exploring and learning alone
    total_seconds: float  # since the call, with compiling and evaluating
    env_steps: int
    hypervolume: dict[str, float]  # by protocol


def configured(env: str, changes: dict[str, Any], seed: int, device: torch.device) -> Config:
    """A task's own config with changes by dotted names."""
    own = task_values(env, device.type)
    values = merged(own, {"seed": seed, "device": str(device)})
    for name, value in changes.items():
        *sections, key = name.split(".")
        nested = {key: value}
        for section in reversed(sections):
            nested = {section: nested}
        values = merged(values, nested)
    return load_config(values)


def training_curve(
    config: Config, seconds: float, every: float, protocols: Sequence[Protocol] = ("latched",)
) -> list[Point]:
    """Evaluations every so many training seconds; they stop early if a loss is not finite."""
    began = time.perf_counter()
    env = make_worlds(config, config.worlds)
    morlax = MORLAX(env, config)
    evaluators = {name: _evaluator(morlax, config, name) for name in protocols}
    morlax.compile()
    for evaluator in evaluators.values():
        evaluator.compile()
    on_gpu = env.device.type == "cuda"
    trained, points = 0.0, []
    while trained < seconds:
        start = time.perf_counter()
        while time.perf_counter() - start < every:
            morlax.iterate()
            if on_gpu and morlax.iteration % AHEAD == 0:
                torch.cuda.synchronize()
        metrics = morlax.metrics()
        trained += time.perf_counter() - start
        found = {name: evaluator.evaluate().hypervolume for name, evaluator in evaluators.items()}
        points.append(Point(trained, time.perf_counter() - began, morlax.env_steps, found))
        if not abs(metrics["value_loss"]) < float("inf"):
            break
    return points


def _evaluator(morlax: MORLAX, config: Config, protocol: Protocol) -> Evaluator:
    m = len(morlax.env.objectives)
    if protocol == "paper":
        tradeoffs = dirichlet_tradeoffs(1024, m)
    else:
        tradeoffs = evaluation_tradeoffs(config.evaluation.tradeoffs, m)
    judges = make_worlds(config, len(tradeoffs), judging=True)
    return Evaluator(morlax.agent, judges, tradeoffs, protocol)


def reached(points: Sequence[Point], target: float, protocol: Protocol = "latched") -> float | None:
    """Training seconds until a hypervolume was reached, None if it never was."""
    return next((p.train_seconds for p in points if p.hypervolume[protocol] >= target), None)
