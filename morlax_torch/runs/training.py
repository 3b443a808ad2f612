"""The training loop: explore and learn, evaluate, write what was found."""

import math
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Self

from torch import inference_mode, nn

from ..algorithms.learner import Learner
from ..algorithms.registry import make_learner
from ..configuration.config import Config
from ..envs import MorlaxError
from ..envs.devices import seed_of
from ..envs.errors import NotFinite
from ..envs.naming import is_file
from ..evaluation.evaluator import SETS, Evaluator
from ..evaluation.evaluator import make_evaluator as evaluator_of
from ..evaluation.front import mean_indicators
from ..gpu.group import join
from ..host.files import AnyPath
from ..host.phases import phase
from ..host.torchrun import launch
from . import checkpoint
from .loading import start_from
from .progress import Evaluation, Progress
from .run import Run, load_libraries

UNSTABLE = (
    "numbers of the simulation or the reward are not finite or far too large, so nothing can be "
    "learned: check the task's rewards and observations, or use a smaller time step in its MJCF"
)
TRAINING = "training"  # the phase
MOST_WAITING = 12  # reports, evaluations, with a copy of the learner's state, and their pictures
# iterations between reads of the metrics, each of which waits for the GPU, and seconds, at most
REPORT_EVERY, REPORT_SECONDS = 10, 1.0
EVALUATION_SHARE = 0.08  # of the training loop's time, if evaluations are spaced by their cost
SHORT = 10.0  # seconds of training, below which only trained policies are evaluated
MEASURED = {"env_steps", "train_seconds", "total_seconds", "steps_per_second", "blowups", "series"}
HYPERVOLUMES = {"hypervolume", "best_hypervolume", "best_selection"}  # of `Progress`, as MEASURED

Job = Callable[[], Evaluation | None]


@dataclass
class Session:
    """Worlds with their learner, its evaluator, and the run that is written, if any."""

    learner: Learner
    evaluator: Evaluator
    run: Run | None = None
    progress: Progress = field(default_factory=Progress)  # of a resumed run; updated in place
    on_metrics: Callable[[dict[str, float], int], object] = lambda scalars, env_steps: None

    @classmethod
    @inference_mode(False)
    def of(
        cls,
        config: Config,
        run: Run | None = None,
        output: AnyPath | None = None,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
    ) -> Self:
        """Make worlds, learner, evaluator and a run; see `morlax_torch.train`."""
        device, group = join(config.device, config.model_dump_json())
        config = config.model_copy(update={"device": device})
        if not group.first(run is not None):
            run = None  # this host may have an older folder of that name
        elif run is None:
            raise MorlaxError(
                f"process 0 resumes a run whose folder process {group.rank} cannot find: put it on "
                "a disk that all hosts share."
            )
        worlds = config.make_worlds(config.worlds, seed_of(config.seed, group.rank))
        learner = make_learner(worlds, config, actor=actor, critic=critic, group=group)
        evaluator = make_evaluator(learner)
        if run is not None:
            return cls(learner, evaluator, run, run.restore(learner))
        if config.start_from is not None:
            start_from(config.start_from, learner)
        return cls(learner, evaluator, Run.create(learner, output))

    @inference_mode(False)  # learns also inside a user's no_grad
    def training(
        self, began: float | None = None, *, stopped: Callable[[], bool] = lambda: False
    ) -> Generator[Evaluation, None, None]:
        """Train to a limit of the learner's config, and yield each evaluation.

        The first evaluation comes before training, unless that is SHORT. A thread writes the run's
        folder while training goes on, so the learner may be ahead of an evaluation when it is
        yielded. However training ends, everything evaluated so far is written first, so the
        iterator may be closed at any time.

        `total_seconds` count from `began`, a value of `time.perf_counter()`. After each iteration,
        `stopped` is asked whether to stop.
        """
        learner, group, progress = self.learner, self.learner.group, self.progress
        run = self._output
        began = (time.perf_counter() if began is None else began) - progress.total_seconds
        progress.processes, progress.launch = group.size, launch()
        schedule = Schedule(learner, progress)
        # worlds that start anew count their blow-ups from zero
        earlier = progress.blowups - sum(group.gather(int(learner.env.blowups)))
        resumed = group.first(run is not None and run.has_evaluation(learner.iteration))
        evaluated = learner.iteration if resumed else None
        with run or nullcontext(), Writer(MOST_WAITING if run else 0) as writer:
            try:
                learner.compile()
                self.evaluator.compile()
                if run:  # while the GPU is evaluating
                    writer.put(load_libraries)
                while True:
                    interrupted = stopped()
                    over = interrupted or schedule.over()
                    due = schedule.evaluation_due() or (over and not interrupted)
                    # the clocks of several processes differ, so the first one decides
                    interrupted, over, due = group.first((interrupted, over, due))
                    if due and evaluated != learner.iteration:
                        evaluated, start = learner.iteration, time.perf_counter()
                        for job in self._evaluate(began):
                            writer.put(job)
                        schedule.evaluated(time.perf_counter() - start)
                    yield from writer.results(all_of_them=over)
                    if over:
                        break
                    yield from self._explore_and_learn(schedule, stopped, writer, earlier)
            except MorlaxError:
                yield from writer.results(all_of_them=True)
                raise
            progress.total_seconds = time.perf_counter() - began
            if interrupted:
                contents = self._snapshot()
                if run:
                    run.save(contents, progress)

    @property
    def _output(self) -> Run | None:  # in the process that writes it
        return self.run if self.learner.group.rank == 0 else None

    def _explore_and_learn(
        self, schedule: "Schedule", stopped: Callable[[], bool], writer: "Writer", earlier: int
    ) -> Iterator[Evaluation]:
        """Iterate until the next look at limits and metrics, then check the metrics."""
        learner, progress = self.learner, self.progress
        first, start, alone = learner.iteration, time.perf_counter(), learner.group.size == 1
        seconds = schedule.seconds()
        # several processes have one clock, which they look at together
        plan = schedule.iterations(), schedule.pace(), progress.train_seconds
        number, pace, trained = learner.group.first(plan)
        for i in range(number):
            if alone and learner.env.device.type == "cpu":
                away = time.perf_counter()
                yield from writer.results()
                start += time.perf_counter() - away
            elapsed = time.perf_counter() - start if alone else 0.0
            # a GPU runs behind, so its clock is predicted
            done = schedule.done(trained + max(elapsed, i * pace))
            phase(TRAINING, done)
            learner.iterate(done)  # explore with the policies of K trade-offs, then learn
            if alone and (stopped() or time.perf_counter() - start >= seconds):
                break
        metrics = learner.metrics()  # waits for the GPU
        elapsed, iterations = time.perf_counter() - start, learner.iteration - first
        metrics["blowups"] += earlier  # counted before the worlds were rebuilt
        blowups, progress.blowups = progress.blowups, int(metrics["blowups"])
        progress.train_seconds += elapsed
        progress.env_steps = learner.env_steps
        progress.steps_per_second = iterations * learner.steps_per_iteration / elapsed
        self._check(metrics, first, progress.blowups - blowups)
        metrics["env_steps_per_second"] = progress.steps_per_second
        scalars = {f"train/{name}": value for name, value in metrics.items()}
        if learner.rates is not None and not learner.config.task.guide:  # which fronts do not count
            scalars["front/hypervolume_estimate"] = self.evaluator.estimate(learner.rates)
        self.on_metrics(scalars, learner.env_steps)
        if self._output:
            writer.put(partial(self._output.log_scalars, scalars, learner.env_steps))

    def _evaluate(self, began: float) -> Iterator[Job]:
        """Evaluate, copy the learner's state, and yield jobs that write both, then pictures."""
        learner, progress, run = self.learner, self.progress, self._output
        fronts = self.evaluator.evaluate_sets()
        if fronts[0].blowups is not None and fronts[0].blowups.all():
            raise self._failure(
                f"every episode blew up in the evaluation after iteration {learner.iteration}: "
                f"{UNSTABLE}"
            )
        progress.total_seconds = time.perf_counter() - began
        iteration = learner.iteration
        now = progress.model_copy(update={"env_steps": learner.env_steps})
        # of several processes, each copies its own state
        contents = self._snapshot() if run or learner.group.size > 1 else {}
        number = bodies(learner.config)
        front = fronts[0].parts(number)[0]

        def work() -> Evaluation:
            reported, *selecting = (mean_indicators(each.parts(number)) for each in fronts)
            mark = checkpoint.fingerprint(contents["learner"]["agent"]) if run else None
            evaluation = Evaluation(
                iteration,
                front=front._replace(fingerprint=mark),
                indicators=reported,
                selection=selecting[0] if selecting else None,
                **now.model_dump(include=MEASURED),
            )
            best = progress.improved(evaluation.selection_hypervolume, evaluation.hypervolume)
            evaluation = evaluation._replace(best=best)
            if run:
                run.log_evaluation(evaluation, learner.config)
                hypervolumes = progress.model_dump(include=HYPERVOLUMES)
                run.save(contents, now.model_copy(update=hypervolumes), evaluation)
            return evaluation

        yield work
        if run:  # once the row is told
            yield partial(run.draw, front, learner.config, now.env_steps)

    def _check(self, metrics: dict[str, float], first: int, blowups: int) -> None:
        learner = self.learner
        iterations = learner.iteration - first
        span = f"iterations {first + 1} to {learner.iteration}"
        if metrics["overflow"]:
            remedy = learner.env.remedy(int(metrics["overflow"]))
            raise self._failure(f"contacts overflowed their buffers in {span}: {remedy}")
        # also before the first update
        unstable = blowups >= learner.steps_per_iteration * iterations
        remedy = UNSTABLE if unstable else self._remedy()
        for name, value in metrics.items():
            if (name == "entropy" or name.endswith("_loss")) and not math.isfinite(value):
                raise self._failure(
                    f"the {name.replace('_', ' ')} became {value} in {span} "
                    f"({metrics['blowups']:.0f} worlds have blown up so far): {remedy}"
                )
        if blowups >= learner.config.worlds * learner.group.size * iterations:
            raise self._failure(f"every world blew up in each rollout of {span}: {UNSTABLE}")

    def _snapshot(self) -> dict[str, Any]:
        """Copy the learner's state, or say which number of it is not finite."""
        try:
            return checkpoint.snapshot(self.learner)
        except NotFinite as error:
            iteration = self.learner.iteration
            raise self._failure(f"{error} after iteration {iteration}: {self._remedy()}") from None

    def _remedy(self) -> str:
        config = self.learner.config
        remedy = f"try a lower --{'method' if config.method.off_policy else 'ppo'}.learning-rate"
        if is_file(config.scalarization):
            remedy += ", or a utility whose derivative is finite at all returns"
        return remedy

    def _failure(self, sentence: str) -> MorlaxError:
        run = self._output
        kept = f" The last good checkpoint is {run.checkpoints / 'latest.pt'}." if run else ""
        return MorlaxError(f"{sentence}.{kept}")


def make_evaluator(learner: Learner) -> Evaluator:
    """Make the evaluator of a learner's agent; a random task has a second set, to choose by."""
    config, group = learner.config, learner.group
    sets, number = SETS if config.task.for_evaluation().varies else 1, bodies(config)
    return evaluator_of(learner.agent, config, sets=sets, group=group, bodies=number)


def bodies(config: Config) -> int:  # that evaluations have
    return config.evaluation.designs if config.sampling.designs else 1


def is_short(config: Config) -> bool:
    """Return whether training is over before untrained policies would be worth an evaluation."""
    return config.evaluation.every is None and (config.max_seconds or math.inf) < SHORT


class Schedule:
    """The limits of a learner's config, in iterations and seconds.

    Evaluations come at the config's interval, else so that they take about EVALUATION_SHARE of the
    training loop's time; of SHORT training, only at its end. `progress` is read live.
    """

    def __init__(self, learner: Learner, progress: Progress):
        config, env = learner.config, learner.env
        self._learner, self._progress = learner, progress
        self._max_env_steps = config.max_env_steps or math.inf
        self._max_seconds = config.max_seconds or math.inf
        self._interval: int | None = None  # iterations between evaluations; None: seconds decide
        if config.evaluation.every is not None:
            self._interval = max(1, config.evaluation.every // learner.steps_per_iteration)
        self._next_second = math.inf if is_short(config) else progress.train_seconds
        self._expects_cost = env.device.type == "cuda" and not env.recordable

    def over(self) -> bool:
        return self._progress.train_seconds >= self._max_seconds or self._iterations_left() <= 0

    def done(self, seconds: float) -> float:
        """Return the share of the run that is over after so many training seconds, 0 to 1."""
        steps = self._learner.env_steps / self._max_env_steps
        return min(1.0, max(steps, seconds / self._max_seconds))

    def evaluation_due(self) -> bool:
        if self._interval is not None:
            return self._learner.iteration % self._interval == 0
        if self._expects_cost:
            if not self.pace():
                return False
            self._expects_cost = False
            steps = self._learner.env.episode_length / self._learner.config.horizon
            self.evaluated(steps * self.pace())
        return self._next_second <= self._progress.train_seconds

    def evaluated(self, cost: float) -> None:
        """Plan the next evaluation, after one that kept training waiting for `cost` seconds."""
        now = self._progress.train_seconds
        self._next_second = now + (1 / EVALUATION_SHARE - 1) * cost

    def iterations(self) -> int:
        """Return how many iterations may pass until the next look at limits and metrics."""
        count = min(REPORT_EVERY, self._iterations_left())
        if self._interval is not None:
            count = min(count, self._interval - self._learner.iteration % self._interval)
        if pace := self.pace():  # a GPU is too far behind to watch the clock instead
            count = min(count, max(1, math.ceil(self.seconds() / pace)))
        return int(count)

    def pace(self) -> float:
        """Return the seconds that an iteration took lately; 0 before the first."""
        speed = self._progress.steps_per_second
        return self._learner.steps_per_iteration / speed if speed else 0.0

    def seconds(self) -> float:
        """Return how many seconds of training may pass until the next look."""
        end = self._max_seconds
        end = end if self._interval is not None else min(end, self._next_second)
        return min(REPORT_SECONDS, end - self._progress.train_seconds)

    def _iterations_left(self) -> float:
        left = (self._max_env_steps - self._learner.env_steps) / self._learner.steps_per_iteration
        return left if left == math.inf else math.ceil(left)


class Writer(ThreadPoolExecutor):
    """Runs jobs one after the other in a thread of its own, at most `most_waiting` unfinished.

    After the first error, which `results` or the exit raises, later jobs are dropped.
    """

    def __init__(self, most_waiting: int):
        super().__init__(1, "morlax-writer")
        self._most_waiting = most_waiting
        self._jobs: deque[Future[Evaluation | None]] = deque()
        self._failed = False

    def put(self, job: Job) -> None:
        """Queue a job, and wait while too many are unfinished."""
        self._jobs.append(self.submit(self._run, job))
        wait(list(self._jobs)[: max(0, len(self._jobs) - self._most_waiting)])

    def results(self, all_of_them: bool = False) -> Iterator[Evaluation]:
        """Yield the evaluations of finished jobs, in order, each once, or of `all_of_them`."""
        while self._jobs and (all_of_them or self._jobs[0].done()):
            if evaluation := self._jobs.popleft().result():
                yield evaluation

    def _run(self, job: Job) -> Evaluation | None:
        if self._failed:
            return None
        try:
            return job()
        except BaseException:
            self._failed = True
            raise

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.shutdown()
        if kind is None or issubclass(kind, GeneratorExit):
            list(self.results())
