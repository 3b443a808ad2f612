"""The training loop."""

import math
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import nullcontext
from functools import partial

from ..algorithms.learner import Learner
from ..configuration.config import Config
from ..envs import MorlaxError, Worlds
from ..envs.devices import seed_of
from ..evaluation import making
from ..evaluation.evaluator import SETS, Evaluator
from ..evaluation.front import Front, mean_indicators
from ..host.phases import phase
from ..host.torchrun import launch
from . import checkpoint
from .progress import Evaluation, Progress
from .run import Run
from .schedule import Schedule
from .writer import Job, Writer

UNSTABLE = (
    "numbers of the simulation or the reward are not finite or far too large, so nothing can be "
    "learned: check the task's rewards and observations, or use a smaller time step in its MJCF"
)
TRAINING = "training"  # the phase
MOST_WAITING = 8  # reports and evaluations, each with a copy of the learner's state, to be written


def training(
    learner: Learner,
    evaluator: Evaluator,
    run: Run | None = None,
    progress: Progress | None = None,
    began: float | None = None,
    *,
    stopped: Callable[[], bool] = lambda: False,
    evaluate_at: Sequence[float] | None = None,
) -> Generator[Evaluation, None, None]:
    """Train to a limit of the learner's config, and yield each evaluation.

    The first evaluation comes before training.

    A thread writes the run's folder while training goes on, so the learner may be ahead of an
    evaluation when it is yielded. The evaluation and its checkpoint are in the folder by then.
    However training ends, everything evaluated so far is written first, so the iterator may be
    closed at any time. Without a run, each evaluation is yielded before training goes on.

    It prints nothing and installs no signal handlers, so it works in threads and notebooks.

    Args:
        learner: trained in place.
        evaluator: of the learner's agent.
        run: where to write; None: nowhere.
        progress: of a resumed run; updated in place.
        began: value of `time.perf_counter()` from which `total_seconds` counts (None: now).
        stopped: asked after each iteration whether to stop there.
        evaluate_at: training seconds at which to evaluate, instead of the config's interval.

    Raises:
        MorlaxError: the folder cannot be written, the simulator's buffers overflow, every world
            blows up, or a loss is not finite. Checkpoints keep their last good state.
    """
    progress = Progress() if progress is None else progress
    began = time.perf_counter() if began is None else began
    began -= progress.total_seconds
    progress.processes, progress.launch = learner.group.size, launch()
    schedule = Schedule(learner, progress, evaluate_at)
    # worlds that start anew count from zero
    earlier = progress.blowups - sum(learner.group.gather(int(learner.env.blowups)))
    known = learner.group.first(run is not None and run.has_evaluation(learner.iteration))
    evaluated = learner.iteration if known else None
    with run or nullcontext(), Writer(MOST_WAITING if run else 0) as writer:
        try:
            learner.compile()
            evaluator.compile()
            while True:
                interrupted, finished, due = learner.group.first(_next(stopped, schedule))
                if due and evaluated != learner.iteration:
                    evaluated, start = learner.iteration, time.perf_counter()
                    fronts = evaluator.evaluate_sets()
                    _check_front(fronts[0], learner, run)
                    progress.total_seconds = time.perf_counter() - began
                    writer.put(_report(learner, fronts, progress, run))
                    schedule.evaluated(time.perf_counter() - start)
                yield from writer.results(all_of_them=finished)
                if finished:
                    break
                yield from _iterate(learner, schedule, stopped, progress, run, writer, earlier)
        except MorlaxError:
            yield from writer.results(all_of_them=True)
            raise
        progress.total_seconds = time.perf_counter() - began
        if interrupted:
            contents = checkpoint.snapshot(learner)
            if run:
                run.save(contents, progress)


def _next(stopped: Callable[[], bool], schedule: Schedule) -> tuple[bool, bool, bool]:
    interrupted = stopped()
    finished = interrupted or schedule.over()
    return interrupted, finished, schedule.evaluation_due() or (finished and not interrupted)


def _report(learner: Learner, fronts: Sequence[Front], progress: Progress, run: Run | None) -> Job:
    """Copy the state that an evaluation is of, and return a job that measures and writes it.

    Of the `fronts` of each set of episodes, the first is reported, the last chooses the checkpoint.
    """
    iteration, env_steps, now = learner.iteration, learner.env_steps, progress.model_copy()
    contents = checkpoint.snapshot(learner) if run or learner.group.size > 1 else {}

    def work() -> Evaluation:
        number = bodies(learner.config)
        front = fronts[0].parts(number)[0]
        indicators = [mean_indicators(each.parts(number)) for each in fronts]
        if run:
            mark = checkpoint.fingerprint(contents["learner"]["agent"])
            front = front._replace(fingerprint=mark)
        evaluation = Evaluation(
            iteration,
            env_steps,
            now.train_seconds,
            now.total_seconds,
            now.steps_per_second,
            now.blowups,
            front,
            indicators[0],
            selection=indicators[1] if len(fronts) > 1 else None,
        )
        best = progress.improved(evaluation.selection_hypervolume, evaluation.hypervolume)
        evaluation = evaluation._replace(best=best)
        if run:
            for name in ("hypervolume", "best_hypervolume", "best_selection"):
                setattr(now, name, getattr(progress, name))
            run.log_evaluation(evaluation, learner.config.env)
            run.save(contents, now, evaluation)
        return evaluation

    return work


def make_worlds(config: Config, number: int, rank: int = 0) -> Worlds:
    """Make the worlds that `config` trains in, in the process `rank`."""
    return config.make_worlds(number, seed_of(config.seed, rank))


def make_evaluator(learner: Learner) -> Evaluator:
    """Make the evaluator of a learner's agent.

    Where a task is random, it has a second set of episodes, to choose the best checkpoint by.
    """
    config, m = learner.config, len(learner.env.objectives)
    sets = SETS if config.task.for_evaluation().varies else 1
    number = bodies(config)
    return making.make_evaluator(
        learner.agent, config, m, sets=sets, group=learner.group, bodies=number
    )


def bodies(config: Config) -> int:
    """Return how many bodies evaluations while training have."""
    return config.evaluation.designs if config.sampling.designs else 1


def _iterate(
    learner: Learner,
    schedule: Schedule,
    stopped: Callable[[], bool],
    progress: Progress,
    run: Run | None,
    writer: Writer,
    earlier: int,
) -> Iterator[Evaluation]:
    """Run some iterations, then read and check the metrics.

    On a CPU, where an iteration may take a second, yield evaluations as soon as they are written.
    `earlier`: blow-ups counted before the worlds were rebuilt.
    """
    first, start, alone = learner.iteration, time.perf_counter(), learner.group.size == 1
    seconds = schedule.seconds()
    # several processes have one clock, which they look at together
    own = schedule.iterations(), schedule.pace(), progress.train_seconds
    number, pace, trained = learner.group.first(own)
    for i in range(number):
        if alone and learner.env.device.type == "cpu":
            away = time.perf_counter()
            yield from writer.results()
            start += time.perf_counter() - away
        elapsed = time.perf_counter() - start if alone else 0.0
        # a GPU runs behind, so its clock is predicted
        done = schedule.done(trained + max(elapsed, i * pace))
        phase(TRAINING, done)
        learner.iterate(done)
        if alone and (stopped() or time.perf_counter() - start >= seconds):
            break
    metrics = learner.metrics()
    elapsed = time.perf_counter() - start
    metrics["blowups"] += earlier
    blowups, progress.blowups = progress.blowups, int(metrics["blowups"])
    progress.train_seconds += elapsed
    progress.env_steps = learner.env_steps
    progress.steps_per_second = (learner.iteration - first) * learner.steps_per_iteration / elapsed
    rollouts = learner.config.worlds * learner.group.size * (learner.iteration - first)
    all_blew_up = progress.blowups - blowups >= rollouts
    _check(metrics, all_blew_up, learner, first, run)
    if run:
        speed = progress.steps_per_second
        writer.put(partial(run.log_metrics, metrics, learner.env_steps, speed))


def _check(
    metrics: dict[str, float], all_blew_up: bool, learner: Learner, first: int, run: Run | None
) -> None:
    """Raise MorlaxError if the iterations after `first` cannot be trusted."""
    span = f"iterations {first + 1} to {learner.iteration}"
    if metrics["overflow"]:
        remedy = learner.env.remedy(int(metrics["overflow"]))
        raise MorlaxError(f"contacts overflowed their buffers in {span}: {remedy}.{_kept(run)}")
    section = "method" if learner.config.off_policy else "ppo"
    for name, value in metrics.items():
        if (name == "entropy" or name.endswith("_loss")) and not math.isfinite(value):
            raise MorlaxError(
                f"the {name.replace('_', ' ')} became {value} in {span} "
                f"({metrics['blowups']:.0f} worlds have blown up so far): "
                f"try a lower --{section}.learning-rate.{_kept(run)}"
            )
    if all_blew_up:
        raise MorlaxError(f"every world blew up in each rollout of {span}: {UNSTABLE}.{_kept(run)}")


def _check_front(front: Front, learner: Learner, run: Run | None) -> None:
    if front.blowups is not None and front.blowups.all():
        raise MorlaxError(
            f"every episode blew up in the evaluation after iteration {learner.iteration}: "
            f"{UNSTABLE}.{_kept(run)}"
        )


def _kept(run: Run | None) -> str:
    return f" The last good checkpoint is {run.checkpoints / 'latest.pt'}." if run else ""
