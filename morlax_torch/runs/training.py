"""The training loop."""

import math
import time
from collections.abc import Callable, Generator
from typing import NamedTuple, Self

from .. import envs
from ..algorithms.learner import Learner
from ..config import Config
from ..envs import MorlaxError, Worlds
from ..envs.random import EVALUATION_SEEDS
from ..evaluation.evaluator import Evaluator, Protocol
from ..evaluation.front import Front
from ..tradeoffs import dirichlet_tradeoffs, evaluation_tradeoffs
from .progress import Evaluation, Progress
from .run import Run

UNSTABLE = (
    "numbers of the simulation or the reward are not finite or far too large, so nothing can be "
    "learned: check the task's rewards and observations, or use a smaller time step in its MJCF"
)
REPORT_EVERY = 10  # iterations between reads of the metrics, each of which waits for the GPU


class Limits(NamedTuple):
    """When to evaluate and when to stop."""

    max_env_steps: int | None = None
    max_seconds: float | None = None  # of training time
    evaluate_every: int = 2_000_000  # environment steps
    evaluate_seconds: float | None = None  # of training time, instead of `evaluate_every`
    stopped: Callable[[], bool] = lambda: False  # asked after each iteration

    @classmethod
    def of(cls, config: Config, stopped: Callable[[], bool] = lambda: False) -> Self:
        """Return the limits of a config."""
        return cls(
            config.max_env_steps, config.max_seconds, config.evaluation.every, stopped=stopped
        )


def training(
    learner: Learner,
    evaluator: Evaluator,
    limits: Limits,
    run: Run | None = None,
    progress: Progress | None = None,
) -> Generator[Evaluation, None, None]:
    """Train, and yield each evaluation, the first of them before training.

    Evaluations and checkpoints are in the run's folder when an evaluation is yielded, so the
    iterator may be closed at any time. It prints nothing and installs no signal handlers, so it
    works in threads and notebooks.

    Args:
        learner: trained in place.
        evaluator: of the learner's agent.
        limits: when to evaluate and when to stop.
        run: where to write; None: nowhere.
        progress: of a resumed run; updated in place.

    Raises:
        MorlaxError: the folder cannot be written, the simulator's buffers overflow, every world
            blows up, or a loss is not finite. Checkpoints keep their last good state.
    """
    progress = Progress() if progress is None else progress
    began = time.perf_counter() - progress.total_seconds
    schedule = _Schedule(learner, limits, progress)
    evaluated = learner.iteration if run and run.has_evaluation(learner.iteration) else None
    try:
        learner.compile()
        evaluator.compile()
        while True:
            stopped = limits.stopped()
            finished = stopped or schedule.over()
            due = schedule.evaluation_due() or (finished and not stopped)
            if due and evaluated != learner.iteration:
                evaluated = learner.iteration
                front = evaluator.evaluate()
                _check_front(front, learner, run)
                progress.total_seconds = time.perf_counter() - began
                evaluation = _evaluation(learner, progress, front)
                best = progress.improved(evaluation.hypervolume)
                if run:
                    run.log_evaluation(evaluation, learner.config.env)
                    run.save(learner, progress, best)
                schedule.evaluated()
                yield evaluation
            if finished:
                break
            _iterate(learner, schedule, limits, progress, run)
        progress.total_seconds = time.perf_counter() - began
        if stopped and run:
            run.save(learner, progress)
    finally:
        if run:
            run.close()


def make_worlds(config: Config, number: int) -> Worlds:
    """Make the worlds that `config` trains in."""
    return envs.make(
        config.env,
        number,
        config.device,
        config.backend,
        config.seed,
        deterministic=config.deterministic,
        **config.task.model_dump(),
    )


def make_evaluator(learner: Learner, protocol: Protocol = "latched") -> Evaluator:
    """Make the evaluator of a learner's agent, with the same worlds for every training seed.

    The paper's protocol evaluates 1,024 random trade-offs, the default protocol the config's
    number, spread evenly.
    """
    config, m = learner.config, len(learner.env.objectives)
    if protocol == "paper":
        tradeoffs = dirichlet_tradeoffs(1024, m)
    else:
        tradeoffs = evaluation_tradeoffs(config.evaluation.tradeoffs, m)
    env = envs.make(
        config.env,
        len(tradeoffs),
        config.device,
        config.backend,
        EVALUATION_SEEDS,
        auto_reset=False,
        deterministic=config.deterministic,
        **config.task.for_evaluation().model_dump(),
    )
    return Evaluator(learner.agent, env, tradeoffs, protocol)


class _Schedule:
    """The limits in iterations."""

    def __init__(self, learner: Learner, limits: Limits, progress: Progress):
        self.learner, self.limits, self.progress = learner, limits, progress
        steps = learner.steps_per_iteration
        self.interval = max(1, limits.evaluate_every // steps)
        self.last = math.inf
        if limits.max_env_steps is not None:
            self.last = math.ceil(limits.max_env_steps / steps)
        self._next_second = progress.train_seconds

    def over(self) -> bool:
        most = self.limits.max_seconds
        timed_out = most is not None and self.progress.train_seconds >= most
        return timed_out or self.learner.iteration >= self.last

    def evaluation_due(self) -> bool:
        if self.limits.evaluate_seconds is not None:
            return self.progress.train_seconds >= self._next_second
        return self.learner.iteration % self.interval == 0

    def evaluated(self) -> None:
        if self.limits.evaluate_seconds is not None:
            self._next_second = self.progress.train_seconds + self.limits.evaluate_seconds

    def iterations(self) -> int:
        """How many iterations may pass until the next look at limits and metrics."""
        count = min(REPORT_EVERY, self.last - self.learner.iteration)
        if self.limits.evaluate_seconds is None:
            count = min(count, self.interval - self.learner.iteration % self.interval)
        return int(count)

    def seconds(self) -> float:
        """How many seconds may pass until then."""
        if self.limits.evaluate_seconds is None:
            return math.inf
        return self._next_second - self.progress.train_seconds


def _iterate(
    learner: Learner, schedule: _Schedule, limits: Limits, progress: Progress, run: Run | None
) -> None:
    """Run some iterations, then read and check the metrics."""
    first, start = learner.iteration, time.perf_counter()
    seconds = schedule.seconds()
    for _ in range(schedule.iterations()):
        learner.iterate()
        if limits.stopped() or time.perf_counter() - start >= seconds:
            break
    metrics = learner.metrics()
    elapsed = time.perf_counter() - start
    blowups, progress.blowups = progress.blowups, int(metrics["blowups"])
    progress.train_seconds += elapsed
    progress.env_steps = learner.env_steps
    progress.steps_per_second = (learner.iteration - first) * learner.steps_per_iteration / elapsed
    _check(metrics, learner, first, run)
    if progress.blowups - blowups >= learner.config.worlds * (learner.iteration - first):
        raise MorlaxError(
            f"every world blew up in each rollout of {_span(learner, first)}: "
            f"{UNSTABLE}.{_kept(run)}"
        )
    if run:
        run.log_metrics(metrics, learner.env_steps, progress.steps_per_second)


def _evaluation(learner: Learner, progress: Progress, front: Front) -> Evaluation:
    return Evaluation(
        learner.iteration,
        learner.env_steps,
        progress.train_seconds,
        progress.total_seconds,
        progress.steps_per_second,
        progress.blowups,
        front,
        front.indicators(),
    )


def _check(metrics: dict[str, float], learner: Learner, first: int, run: Run | None) -> None:
    """Raise MorlaxError if the iterations after `first` cannot be trusted."""
    span = _span(learner, first)
    if metrics["overflow"]:
        remedy = learner.env.remedy(int(metrics["overflow"]))
        raise MorlaxError(f"contacts overflowed their buffers in {span}: {remedy}.{_kept(run)}")
    for name, value in metrics.items():
        if (name == "entropy" or name.endswith("_loss")) and not math.isfinite(value):
            raise MorlaxError(
                f"the {name.replace('_', ' ')} became {value} in {span} "
                f"({metrics['blowups']:.0f} worlds have blown up so far): "
                f"try a lower --ppo.learning-rate.{_kept(run)}"
            )


def _check_front(front: Front, learner: Learner, run: Run | None) -> None:
    """Raise MorlaxError if every episode of the evaluation blew up."""
    if front.blowups is not None and front.blowups.all():
        raise MorlaxError(
            f"every episode blew up in the evaluation after iteration {learner.iteration}: "
            f"{UNSTABLE}.{_kept(run)}"
        )


def _span(learner: Learner, first: int) -> str:
    return f"iterations {first + 1} to {learner.iteration}"


def _kept(run: Run | None) -> str:
    return f" The last good checkpoint is {run.checkpoints / 'latest.pt'}." if run else ""
