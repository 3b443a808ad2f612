"""When to evaluate and when to stop."""

import math
from collections.abc import Callable
from typing import NamedTuple, Self

from ..algorithms.learner import Learner
from ..config import Config
from .progress import Progress

REPORT_EVERY = 10  # iterations between reads of the metrics, each of which waits for the GPU
EVALUATION_SHARE = 0.08  # of the training loop's time, if evaluations are spaced by their cost


class Limits(NamedTuple):
    """When to evaluate and when to stop.

    Without `evaluate_every` and `evaluate_seconds`, evaluations are spaced by their cost, so that
    they take about EVALUATION_SHARE of the training loop's time.
    """

    max_env_steps: int | None = None
    max_seconds: float | None = None  # of training time
    evaluate_every: int | None = None  # environment steps
    # of training time, instead of `evaluate_every`: an interval, or times
    evaluate_seconds: float | tuple[float, ...] | None = None
    stopped: Callable[[], bool] = lambda: False  # asked after each iteration

    @classmethod
    def of(cls, config: Config, stopped: Callable[[], bool] = lambda: False) -> Self:
        """Return the limits of a config."""
        return cls(
            config.max_env_steps, config.max_seconds, config.evaluation.every, stopped=stopped
        )


class Schedule:
    """The limits of a run in iterations and seconds.

    Args:
        learner: that trains.
        limits: when to evaluate and when to stop.
        progress: read live while training updates it.
    """

    def __init__(self, learner: Learner, limits: Limits, progress: Progress):
        self._learner, self._limits, self._progress = learner, limits, progress
        steps = learner.steps_per_iteration
        self._interval: int | None = None  # iterations between evaluations; None: seconds decide
        if limits.evaluate_every is not None and limits.evaluate_seconds is None:
            self._interval = max(1, limits.evaluate_every // steps)
        self._next_second = progress.train_seconds

    def over(self) -> bool:
        most = self._limits.max_seconds
        timed_out = most is not None and self._progress.train_seconds >= most
        return timed_out or self._iterations_left() <= 0

    def time_spent(self, since: float = 0.0) -> float:
        """Return the share of the config's max_seconds that is over.

        Args:
            since: seconds that the progress does not count yet.
        """
        most = self._learner.config.max_seconds
        return 0.0 if most is None else (self._progress.train_seconds + since) / most

    def evaluation_due(self) -> bool:
        if self._interval is None:
            return self._until_evaluation() <= 0
        return self._learner.iteration % self._interval == 0

    def evaluated(self, cost: float) -> None:
        """Plan the next evaluation, after one that kept training waiting for `cost` seconds."""
        now, given = self._progress.train_seconds, self._limits.evaluate_seconds
        if isinstance(given, tuple):
            self._next_second = min((time for time in given if time > now), default=math.inf)
        else:
            gap = (1 / EVALUATION_SHARE - 1) * cost if given is None else given
            self._next_second = now + gap

    def iterations(self) -> int:
        """Return how many iterations may pass until the next look at limits and metrics."""
        iteration, seconds = self._learner.iteration, self.seconds()
        count = min(REPORT_EVERY, self._iterations_left())
        if self._interval is not None:
            count = min(count, self._interval - iteration % self._interval)
        if self._progress.steps_per_second and seconds < math.inf:
            # a GPU is too far behind to watch the clock instead
            speed = self._progress.steps_per_second / self._learner.steps_per_iteration
            count = min(count, max(1, math.ceil(seconds * speed)))
        return int(count)

    def seconds(self) -> float:
        """Return how many seconds of training may pass until then."""
        most = self._limits.max_seconds
        left = math.inf if most is None else most - self._progress.train_seconds
        return left if self._interval is not None else min(left, self._until_evaluation())

    def _iterations_left(self) -> float:
        most = self._limits.max_env_steps
        if most is None:
            return math.inf
        return math.ceil((most - self._learner.env_steps) / self._learner.steps_per_iteration)

    def _until_evaluation(self) -> float:
        return self._next_second - self._progress.train_seconds
