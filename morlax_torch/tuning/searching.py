"""The search: trials, one after the other, until there are enough."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..configuration.config import Config
from ..configuration.files import space_values
from ..envs import resolve_device
from ..envs.naming import title
from ..host.files import AnyPath
from ..host.phases import within
from .plan import Indicator, Plan
from .results import write_results
from .storage import optuna, unusable
from .study import Result, Study
from .trial import run_trial


def tune(
    config: Config,
    space: Mapping[str, Any] | AnyPath | None = None,
    output: AnyPath | None = None,
    *,
    trials: int = 50,
    seconds: float = 60.0,
    indicators: tuple[Indicator, ...] = ("hypervolume",),
    storage: str | None = None,
    study: str | None = None,
    stopped: Callable[[], bool] = lambda: False,
    on_trial: Callable[[Study, Result], None] | None = None,
) -> Study:
    """Search for hyperparameters; returns the study, whose best trial is `ranked()[0]`.

    Trial 0 is `config`. An existing study continues, and other processes may share it. It prints
    nothing and installs no signal handlers.

    Args:
        config: of the task; options outside the space keep its values.
        space: the search space, as plain values or a YAML file (None: configs/tuning/space.yaml).
        output: folder of trials.csv and best.yaml (None: tuning/<task>).
        trials: number of trials of the study, finished ones included.
        seconds: training time of each trial.
        indicators: to optimize; several look for trade-offs, without pruning.
        storage: path of a journal file, or URL of a database (None: journal.log in `output`).
        study: name of the study in its storage (None: the task).
        stopped: asked after each training iteration; true ends the search, and its running trial
            is queued again.
        on_trial: called with the study and each trial of this process once it is written.

    Raises:
        MorlaxError: Optuna is not installed, or space, storage or output cannot be used.
    """
    found = open_study(config, space, output, seconds, indicators, storage, study)
    search(found, folder_of(config, output), trials, stopped, on_trial)
    return found


def folder_of(config: Config, output: AnyPath | None) -> Path:
    return Path(output or Path("tuning") / title(config.env))


def open_study(
    config: Config,
    space: Mapping[str, Any] | AnyPath | None,
    output: AnyPath | None,
    seconds: float,
    indicators: tuple[Indicator, ...],
    storage: str | None,
    study: str | None,
) -> Study:
    """Open or create the study of `tune`, which describes the arguments and errors."""
    if isinstance(space, Mapping):
        values, source = space, "the search space"
    else:
        values = space_values(space, resolve_device(config.device).type)
        source = f"the search space {space}" if space else "the search space"
    plan = Plan.of(config, values, seconds, indicators, source)
    return Study(plan, storage or str(folder_of(config, output) / "journal.log"), study)


def search(
    study: Study,
    folder: Path,
    trials: int,
    stopped: Callable[[], bool],
    on_trial: Callable[[Study, Result], None] | None,
) -> None:
    """Run trials until the study has enough of them, or `stopped`."""
    try:
        while not stopped():
            claim = study.claim(trials)
            if claim is None:
                return
            with within(f"trial {claim.trial.number}"):
                result = run_trial(study, claim, stopped)
            if result is not None:
                write_results(study, folder)
                if on_trial is not None:
                    on_trial(study, result)
    except optuna.exceptions.StorageInternalError as error:  # of a database
        raise unusable(study.storage, error.__cause__ or error) from None
