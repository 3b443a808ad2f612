"""Everything that training needs, from a config."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Self

from torch import nn

from ..algorithms.learner import Learner
from ..algorithms.registry import make_learner
from ..configuration.config import Config
from ..envs import MorlaxError
from ..evaluation.evaluator import Evaluator
from ..gpu.group import Group, join
from ..host.files import AnyPath
from .loading import start_from
from .progress import Evaluation, Progress
from .run import Run
from .training import make_evaluator, make_worlds, training


@dataclass
class Session:
    """Worlds with their learner, its evaluator, and the run that is written, if any."""

    learner: Learner
    evaluator: Evaluator
    run: Run | None
    progress: Progress

    @classmethod
    def of(
        cls,
        config: Config,
        run: Run | None = None,
        output: AnyPath | None = None,
        actor: nn.Module | None = None,
        critic: nn.Module | None = None,
        *,
        written: bool = True,
    ) -> Self:
        """Make worlds, learner, evaluator and run of a config.

        Started by `torchrun`, all processes share the run, which the first one writes.
        `morlax_torch.train` describes the arguments; unless `written`, no new run is made.

        Raises:
            MorlaxError: the processes do not agree, the config does not fit this machine, or the
                folder cannot be written.
        """
        device, group = join(config.device, config.model_dump_json())
        config = config.model_copy(update={"device": device})
        run = _shared(run, group)
        worlds = make_worlds(config, config.worlds, group.rank)
        learner = make_learner(worlds, config, actor, critic, group=group)
        evaluator = make_evaluator(learner)
        if run is not None:
            return cls(learner, evaluator, run, run.restore(learner))
        if config.start_from is not None:
            start_from(config.start_from, learner)
        run = Run.create(learner, output) if written else None
        return cls(learner, evaluator, run, Progress())

    def training(
        self,
        began: float | None = None,
        *,
        stopped: Callable[[], bool] = lambda: False,
        evaluate_at: Sequence[float] | None = None,
    ) -> Generator[Evaluation, None, None]:
        """Train to a limit of the config, and yield each evaluation; see `training`."""
        run = self.run if self.learner.group.rank == 0 else None
        return training(
            self.learner,
            self.evaluator,
            run,
            self.progress,
            began,
            stopped=stopped,
            evaluate_at=evaluate_at,
        )


def _shared(run: Run | None, group: Group) -> Run | None:
    """Return the run to go on with, if the first process has one."""
    if not group.first(run is not None):
        return None  # this host may have an older folder of that name
    if run is None:
        raise MorlaxError(
            f"process 0 resumes a run whose folder process {group.rank} cannot find: put it on a "
            "disk that all hosts share."
        )
    return run
