"""One trial: training with its config, evaluated a few times."""

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, nullcontext
from statistics import fmean
from typing import NamedTuple

from ..configuration.config import Config
from ..envs import MorlaxError
from ..host.phases import within
from ..host.resources import release_memory, shortage_of_memory
from ..runs.progress import Evaluation
from ..runs.training import Session
from .plan import EVALUATED
from .storage import StorageError
from .study import MOST_DEATHS, Claim, Result, Study

SEEDS = 3  # of the base config, and of a trial that stays the best with each of them


def run_trial(study: Study, claim: Claim, stopped: Callable[[], bool]) -> Result | None:
    """Train with a claimed trial's config; returns what is stored, or None if it was stopped."""
    if claim.deaths >= MOST_DEATHS:
        return study.fail(claim, f"{claim.deaths} processes died in it.")
    try:
        return _train(study, claim, stopped)
    except StorageError:
        raise  # it says nothing about the trial, which the next start queues again
    except MorlaxError as error:
        reason = str(error)
    except BaseException as error:
        expected = isinstance(error, MemoryError | RuntimeError)
        shortage = shortage_of_memory(error) if expected else None
        if shortage is None:
            study.put_back(claim)
            raise
        reason = shortage
    finally:
        release_memory()
    return study.fail(claim, reason)


def _train(study: Study, claim: Claim, stopped: Callable[[], bool]) -> Result | None:
    """Train once, or with several seeds if the trial looks like the best one so far.

    The best of many trials is partly luck, which other seeds do not share.
    """
    runs: list[_Run] = []
    while not runs or (len(runs) < SEEDS and study.looks_best(claim, _mean(runs).indicators)):
        with within(f"seed {len(runs) + 1} of {SEEDS}") if runs else nullcontext():
            run = _train_once(study, claim, len(runs), stopped)
        if run is None:
            study.put_back(claim)
            return None
        runs.append(run)
        if run.pruned:
            break
        release_memory()
    return study.finish(claim, *_mean(runs))


class _Run(NamedTuple):
    indicators: dict[str, float]  # of its best evaluation
    train_seconds: float
    env_steps: int
    seeds: int = 1
    pruned: bool = False


def _mean(runs: Sequence[_Run]) -> _Run:
    return _Run(
        {name: fmean(run.indicators[name] for run in runs) for name in runs[0].indicators},
        fmean(run.train_seconds for run in runs),
        round(fmean(run.env_steps for run in runs)),
        len(runs),
        runs[0].pruned,
    )


def _train_once(
    study: Study, claim: Claim, number: int, stopped: Callable[[], bool]
) -> _Run | None:
    """Train with the `number`-th seed; only the first training can be pruned."""
    best, last, seconds = None, None, claim.config.max_seconds or 0.0
    plan, record = study.plan, -math.inf
    config = claim.config.model_copy(update={"seed": claim.config.seed + number})
    with closing(evaluations(config, stopped)) as found:
        for last in found:
            chosen_by = plan.sign * plan.measured(last.measured)[plan.main]
            if best is None or chosen_by > record:
                best, record = plan.measured(last.indicators), chosen_by
            prunable = number == 0 and last.iteration and last.train_seconds < seconds
            if prunable and study.prunes(claim, best[plan.main], last.train_seconds):
                return _Run(best, last.train_seconds, last.env_steps, pruned=True)
    if best is None or last is None or last.train_seconds < seconds:
        return None
    return _Run(best, last.train_seconds, last.env_steps)


def evaluations(config: Config, stopped: Callable[[], bool]) -> Generator[Evaluation, None, None]:
    """Train until max_seconds, and yield the first and last evaluation and those of EVALUATED."""
    seconds = config.max_seconds or 0.0
    times = tuple(share * seconds for share in EVALUATED)
    session = Session.of(config, written=False)
    yield from session.training(stopped=stopped, evaluate_at=times)
