"""When to evaluate, when to stop, and how much of a run is over."""

import math
from collections.abc import Sequence

from ..algorithms.learner import Learner
from .progress import Progress

REPORT_EVERY = 10  # iterations between reads of the metrics, each of which waits for the GPU
EVALUATION_SHARE = 0.08  # of the training loop's time, if evaluations are spaced by their cost


class Schedule:
    """The limits of a learner's config, in iterations and seconds.

    Evaluations come at the training seconds `evaluate_at`, else at the config's interval. Without
    both they are spaced by their cost, so that they take about EVALUATION_SHARE of the training
    loop's time. Where a GPU steps worlds from Python, few worlds take as long as many, so the first
    evaluation comes only when its expected cost is that share. `progress` is read live while
    training updates it.
    """

    def __init__(
        self, learner: Learner, progress: Progress, evaluate_at: Sequence[float] | None = None
    ):
        config, steps = learner.config, learner.steps_per_iteration
        self._learner, self._progress, self._evaluate_at = learner, progress, evaluate_at
        self._max_env_steps, self._max_seconds = config.max_env_steps, config.max_seconds
        self._interval: int | None = None  # iterations between evaluations; None: seconds decide
        if config.evaluation.every is not None and evaluate_at is None:
            self._interval = max(1, config.evaluation.every // steps)
        self._next_second = progress.train_seconds
        env = learner.env
        self._expects_cost = env.device.type == "cuda" and not env.recordable

    def over(self) -> bool:
        timed_out = self._max_seconds and self._progress.train_seconds >= self._max_seconds
        return bool(timed_out) or self._iterations_left() <= 0

    def done(self, seconds: float) -> float:
        """Return the share of the run that is over after so many training seconds, 0 to 1.

        It is that of the limit, of steps or of time, which is nearer. Without limits it is 0.
        """
        steps = self._learner.env_steps / self._max_env_steps if self._max_env_steps else 0.0
        return min(1.0, max(steps, seconds / self._max_seconds if self._max_seconds else 0.0))

    def evaluation_due(self) -> bool:
        if self._interval is None:
            if self._expects_cost and self._evaluate_at is None:
                if not self.pace():
                    return False
                self._expects_cost = False
                steps = self._learner.env.episode_length / self._learner.config.horizon
                self.evaluated(steps * self.pace())
            return self._until_evaluation() <= 0
        return self._learner.iteration % self._interval == 0

    def evaluated(self, cost: float) -> None:
        """Plan the next evaluation, after one that kept training waiting for `cost` seconds."""
        now = self._progress.train_seconds
        if self._evaluate_at is None:
            self._next_second = now + (1 / EVALUATION_SHARE - 1) * cost
        else:
            later = (second for second in self._evaluate_at if second > now)
            self._next_second = min(later, default=math.inf)

    def iterations(self) -> int:
        """Return how many iterations may pass until the next look at limits and metrics."""
        iteration, seconds, pace = self._learner.iteration, self.seconds(), self.pace()
        count = min(REPORT_EVERY, self._iterations_left())
        if self._interval is not None:
            count = min(count, self._interval - iteration % self._interval)
        if pace and seconds < math.inf:
            # a GPU is too far behind to watch the clock instead
            count = min(count, max(1, math.ceil(seconds / pace)))
        return int(count)

    def pace(self) -> float:
        """Return the seconds that an iteration took lately; 0 before the first."""
        speed = self._progress.steps_per_second
        return self._learner.steps_per_iteration / speed if speed else 0.0

    def seconds(self) -> float:
        """Return how many seconds of training may pass until then."""
        left = (self._max_seconds or math.inf) - self._progress.train_seconds
        return left if self._interval is not None else min(left, self._until_evaluation())

    def _iterations_left(self) -> float:
        if self._max_env_steps is None:
            return math.inf
        left = self._max_env_steps - self._learner.env_steps
        return math.ceil(left / self._learner.steps_per_iteration)

    def _until_evaluation(self) -> float:
        return self._next_second - self._progress.train_seconds
