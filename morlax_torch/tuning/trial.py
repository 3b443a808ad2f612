"""One trial: training with its config, evaluated at even times."""

from collections.abc import Callable, Generator
from contextlib import closing

from ..algorithms.registry import make_learner
from ..config import Config
from ..envs import MorlaxError
from ..gpu.memory import release_memory, shortage_of_memory
from ..runs.progress import Evaluation
from ..runs.schedule import Limits
from ..runs.training import make_evaluator, make_worlds, training
from .pruning import EVALUATIONS
from .study import MOST_DEATHS, Claim, Result, Study


def run_trial(study: Study, claim: Claim, stopped: Callable[[], bool]) -> Result | None:
    """Train with the config of a claimed trial and store the result.

    Returns:
        The result; None if it was stopped, and so queued again.
    """
    if claim.deaths >= MOST_DEATHS:
        return study.fail(claim, f"{claim.deaths} processes died in it.")
    try:
        return _train(study, claim, stopped)
    except MorlaxError as error:
        reason = str(error)
    except (MemoryError, RuntimeError) as error:
        shortage = shortage_of_memory(error)
        if shortage is None:
            study.put_back(claim)
            raise
        reason = shortage
    except BaseException:
        study.put_back(claim)
        raise
    finally:
        release_memory()
    return study.fail(claim, reason)


def _train(study: Study, claim: Claim, stopped: Callable[[], bool]) -> Result | None:
    best, last, seconds = None, None, claim.config.max_seconds or 0.0
    sign, main = study.plan.sign, study.plan.main
    with closing(evaluations(claim.config, stopped)) as found:
        for last in found:
            measured = study.plan.measured(last)
            if best is None or sign * measured[main] > sign * best[main]:
                best = measured
            unfinished = last.iteration and last.train_seconds < seconds
            if unfinished and study.prunes(claim, best[main], last.train_seconds):
                return study.finish(claim, best, last.train_seconds, last.env_steps, pruned=True)
    if best is None or last is None or last.train_seconds < seconds:
        study.put_back(claim)
        return None
    return study.finish(claim, best, last.train_seconds, last.env_steps)


def evaluations(config: Config, stopped: Callable[[], bool]) -> Generator[Evaluation, None, None]:
    """Train until max_seconds, and yield evaluations at even training times."""
    learner = make_learner(make_worlds(config, config.worlds), config)
    seconds = config.max_seconds or 0.0
    limits = Limits(None, seconds, evaluate_seconds=seconds / EVALUATIONS, stopped=stopped)
    yield from training(learner, make_evaluator(learner), limits)
