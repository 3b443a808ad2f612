"""The search: a study of Optuna, whose trials train and are evaluated a few times."""

import csv
import io
import json
import math
import os
import random
import socket
import warnings
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, TypeGuard, get_args

import yaml
from filelock import FileLock

from ..configuration.config import Config, flat, load_config
from ..configuration.files import changes, merged, space_values, task_values
from ..envs import MorlaxError, resolve_device
from ..envs.naming import title
from ..evaluation.front import hypervolume_in
from ..host.files import (
    AnyPath,
    attempting,
    make_folder,
    runs,
    write_file,
)
from ..host.phases import within
from ..host.resources import release_memory, shortage_of_memory
from ..runs.progress import Evaluation
from ..runs.training import Session
from .space import Space, State, Trial, optuna

Indicator = Literal["hypervolume", "expected_utility", "sparsity", "obedience", "cardinality"]
FIRST, REDUCTION = 1 / 9, 3  # a third of the trials goes on after 1/9 and 1/3 of the time
SEEDS = 3  # of the base config, and of a trial that stays the best with each of them
MOST_DEATHS = 2  # processes that may die in the same trial before it counts as failed
HEARTBEAT, SILENCE = 60, 600  # seconds: how often a trial in a database tells that it runs
REPEATS = 20  # proposals that were run before, and then draws, in a row, until one is run again
ENOUGH = 20  # trials, from which on TPE draws every second one
CHANGED = 0.1  # share of the options that a trial changes, beside one
FEWEST = 10  # trials, from which on the importance of options is known
JOURNAL = b'{"op_code":'  # begins every line of a journal


class Search:
    """A search for hyperparameters, whose study several processes and machines may share.

    Trial 0 is `config`, and an existing study continues. The `user_attrs` of a trial are its
    `options`, whether it is the `base` config, and what was `measured`: the indicators of its best
    evaluation, `train_seconds` and `env_steps`, means over so many `seeds`; or the `reason` why it
    failed. A failed trial without a reason is void: it was interrupted, or never began.

    Args:
        config: of the task; options outside the space keep its values.
        space: the search space, as plain values or a YAML file (None: configs/tuning/space.yaml).
        output: folder of trials.csv and best.yaml (None: tuning/<task>).
        seconds: training time of each trial.
        indicators: to optimize; several look for trade-offs, without pruning.
        storage: path of a journal file, or URL of a database (None: journal.log in `output`).
        study: name of the study in its storage (None: the task).

    Raises:
        MorlaxError: space, indicators or storage cannot be used, or the storage has a study of this
            name with other options.
    """

    def __init__(
        self,
        config: Config,
        space: Mapping[str, Any] | AnyPath | None = None,
        output: AnyPath | None = None,
        *,
        seconds: float = 60.0,
        indicators: tuple[Indicator, ...] = ("hypervolume",),
        storage: str | None = None,
        study: str | None = None,
    ):
        if not 0 < len(indicators) == len({*indicators} & {*get_args(Indicator)}):
            raise MorlaxError(f"name each indicator once, of {', '.join(get_args(Indicator))}.")
        limits = {"max_seconds": seconds, "max_env_steps": None, "evaluation": {"every": None}}
        self.base = load_config(merged(config.model_dump(mode="json"), limits))
        source = "the search space" if isinstance(space, Mapping | None) else f"the space {space}"
        if not isinstance(space, Mapping):
            space = space_values(space, resolve_device(config.device).type)
        self.space = Space(space, self.base, source)
        self.folder = Path(output or Path("tuning") / title(config.env))
        self.storage = storage or str(self.folder / "journal.log")
        self.seconds, self.indicators, self._repeats = seconds, indicators, 0
        self.main = indicators[0] if len(indicators) == 1 else "hypervolume"
        first = max(1, int(1000 * FIRST * seconds))
        try:
            self.study = optuna.create_study(
                storage=_open(self.storage),
                sampler=optuna.samplers.TPESampler(
                    n_startup_trials=ENOUGH, multivariate=True, constant_liar=True
                ),
                pruner=optuna.pruners.SuccessiveHalvingPruner(first, REDUCTION),
                study_name=study or title(config.env),
                directions=["minimize" if x == "sparsity" else "maximize" for x in indicators],
                load_if_exists=True,
            )
            self._begin()
        except MorlaxError:
            raise
        except Exception as error:  # each database and driver fails in its own way
            raise _unusable(self.storage, error) from None

    def _begin(self) -> None:
        """Queue the base config in a new study; raise MorlaxError if an old one has other options.

        Only trials with equal options can be compared.
        """
        plan = flat(self.base.model_dump(mode="json", exclude={"device", "max_seconds"}))
        plan |= {"seconds": self.seconds, "indicators": self.indicators}
        plan = json.loads(json.dumps({**plan, "space": str(self.space.distributions)}))
        # in this order: a process that starts at the same time sets the plan before its first trial
        empty, stored = not self.study.trials, self.study.user_attrs.get("plan")
        if stored is None and empty:
            self.study.set_user_attr("plan", plan)
            self.study.enqueue_trial(self.space.base_draw(), {"base": True})
            return
        stored = stored or {}
        for name in (key for key in {**stored, **plan} if stored.get(key) != plan.get(key)):
            raise MorlaxError(
                f"the study {self.study.study_name!r} in {self.storage} was started with another "
                f"--{name}: choose another --study or --output, or start it with the same options."
            )

    def trials(self) -> list[Trial]:
        """Return all trials that are not void."""
        return [each for each in self.study.get_trials(deepcopy=False) if not _is_void(each)]

    def finished(self) -> list[Trial]:
        return [trial for trial in self.trials() if trial.state.is_finished()]

    def ranked(self) -> list[Trial]:
        """Return the complete trials, the best ones first; of several indicators, the front."""
        trials = [trial for trial in self.trials() if trial.state == State.COMPLETE]
        if len(self.indicators) > 1:
            trials = self.study.best_trials
        return sorted(trials, key=lambda t: self._score(t.user_attrs["measured"]), reverse=True)

    def _score(self, measured: Mapping[str, float]) -> float:
        return -measured[self.main] if self.main == "sparsity" else measured[self.main]

    def config(self, trial: Trial | optuna.Trial) -> Config:
        return self.base if trial.user_attrs.get("base") else self.space.config(trial.params)

    def run(
        self,
        trials: int = 50,
        stopped: Callable[[], bool] = lambda: False,
        on_trial: Callable[[Trial], object] = lambda trial: None,
    ) -> None:
        """Run trials until the study has so many, those of other processes included.

        `stopped` is asked after each training iteration; true ends the search, and its running
        trial is queued again. `on_trial` is called with each trial once it is written.
        """

        def finished(study: optuna.Study, trial: Trial) -> None:
            if not _is_void(trial):
                self.write()
                on_trial(trial)

        self._most, self._stopped = trials, stopped
        try:
            while not stopped():
                self._revive()
                begun = sum(trial.state != State.WAITING for trial in self.trials())
                if begun >= trials:
                    return
                if self._repeats < REPEATS and (begun < ENOUGH or begun % 2):
                    self._propose()
                self.study.optimize(self._run, 1, callbacks=[finished])
        except Exception as error:
            cause: BaseException | None = error
            while not _is_of_storage(cause):
                if cause is None:
                    raise
                cause = cause.__context__
            raise _unusable(self.storage, cause.__cause__ or cause) from None

    def _revive(self) -> None:
        """Queue the trials of this machine's processes that are gone."""
        for trial in self.study.get_trials(deepcopy=False, states=(State.RUNNING,)):
            host, process = trial.user_attrs.get("process", ("", 0))
            if host == socket.gethostname() and not runs(process):
                # another process may have queued it meanwhile
                with suppress(ValueError, optuna.exceptions.UpdateFinishedTrialError):
                    self.study.tell(trial.number, state=State.FAIL)
                    _queue_again(self.study, trial)

    def _propose(self) -> None:
        """Queue a trial that keeps most options of the best one; the sampler draws the others.

        Most random combinations of many options do not train, and a search has few trials.
        """
        best = [trial.params for trial in self.study.best_trials] or [self.space.base_draw()]
        options = random.choice(best)
        if options and not self.study.get_trials(deepcopy=False, states=(State.WAITING,)):
            one = random.choice([*options])
            kept = [name for name in options if name != one and random.random() >= CHANGED]
            self.study.enqueue_trial({name: options[name] for name in kept})

    def _run(self, trial: optuna.Trial) -> list[float]:
        """Return the indicators of a trial; none if it has failed, or is void."""
        # the storage orders trials, so processes that start one at the same time agree
        earlier = [each for each in self.trials() if each.number < trial.number]
        if len(earlier) >= self._most:
            return []
        trial.set_user_attr("process", (socket.gethostname(), os.getpid()))
        if not trial.user_attrs.get("base") or self.space.base_draw():
            self.space.suggest(trial)
        try:
            values = flat(self.config(trial).model_dump(mode="json"))
        except MorlaxError:  # its values do not fit together
            return []
        repeated = any(each.params == trial.params for each in earlier)
        self._repeats = self._repeats + 1 if repeated else 0
        if repeated and self._repeats <= 2 * REPEATS:
            return []
        options = {name: values.get(name) for name in self.space.distributions}
        trial.set_user_attr("options", options)
        try:
            if (deaths := trial.user_attrs.get("deaths", 0)) >= MOST_DEATHS:
                raise MorlaxError(f"{deaths} processes died in it.")
            return self._train(trial)
        except optuna.TrialPruned:
            raise
        except BaseException as error:
            reason = str(error) if isinstance(error, MorlaxError) else None
            if isinstance(error, MemoryError | RuntimeError):
                reason = shortage_of_memory(error)
            if reason is None:
                _queue_again(self.study, trial, died=False)
                raise
            trial.set_user_attr("reason", reason)
            return []
        finally:
            release_memory()

    def _train(self, trial: optuna.Trial) -> list[float]:
        """Train once, or with several seeds if the trial looks like the best one so far.

        The best of many trials is partly luck, which other seeds do not share.
        """
        base, single = trial.user_attrs.get("base"), len(self.indicators) == 1
        config, trainings, measured = self.config(trial), [], {}
        for number in range(SEEDS):
            with within(f"trial {trial.number}, seed {number + 1}"):
                seeded = config.model_copy(update={"seed": config.seed + number})
                training = self._train_once(trial if single and not number else None, seeded)
            if training is None:
                _queue_again(self.study, trial, died=False)
                return []
            trainings.append(training)
            release_memory()
            measured = {name: fmean(each[name] for each in trainings) for name in training}
            steps = round(measured["env_steps"])
            stored = {**measured, "env_steps": steps, "seeds": number + 1}
            trial.set_user_attr("measured", stored)
            if training["train_seconds"] < self.seconds:
                raise optuna.TrialPruned
            best = self.ranked()[:1]
            beaten = best and self._score(measured) <= self._score(best[0].user_attrs["measured"])
            if not single or (beaten and not base):
                break
        return [measured[name] for name in self.indicators]

    def _train_once(self, trial: optuna.Trial | None, config: Config) -> dict[str, float] | None:
        """Return the numbers of the best evaluation, or None if stopped; `trial` may be pruned."""
        chosen, record, seconds, steps = {}, -math.inf, 0.0, 0
        with closing(evaluations(config, self._stopped)) as evaluated:
            for evaluation in evaluated:
                score = self._score(_plain(evaluation.measured))
                if not chosen or score > record:
                    chosen, record = _plain(evaluation.indicators), score
                seconds, steps = evaluation.train_seconds, evaluation.env_steps
                if trial is not None and steps and seconds < self.seconds:
                    trial.report(chosen[self.main], int(1000 * seconds))
                    if trial.should_prune() and not trial.user_attrs.get("base"):
                        break
            else:
                if seconds < self.seconds:
                    return None
        return {**chosen, "train_seconds": seconds, "env_steps": steps}

    def write(self) -> None:
        """Write trials.csv and, once a trial is complete, best.yaml, or raise MorlaxError."""
        measured = (*get_args(Indicator), "train_seconds", "env_steps", "seeds")
        names = ("number", "state", "base", *measured, *self.space.distributions, "reason")
        table = io.StringIO()
        writer = csv.DictWriter(table, names, extrasaction="ignore")
        writer.writeheader()
        for trial in self.finished():
            about = {**trial.user_attrs, "number": trial.number, "state": trial.state.name.lower()}
            writer.writerow({**about, **about["options"], **about.get("measured", {})})
        make_folder(self.folder)
        # processes must not replace newer files by older ones
        with attempting(f"write to {self.folder}"), FileLock(self.folder / ".lock"):
            write_file(self.folder / "trials.csv", table.getvalue())
            for best in self.ranked()[:1]:
                write_file(self.folder / "best.yaml", self._yaml(best))

    def _yaml(self, trial: Trial) -> str:
        config, measured = self.config(trial), trial.user_attrs["measured"]
        device = resolve_device(config.device).type
        tuned = load_config(task_values(config.env, device, config.algorithm))
        values = config.model_dump(mode="json", exclude={"device", "backend"})
        values = changes(tuned.model_dump(mode="json"), values)
        values = {"env": config.env, "algorithm": config.algorithm, **values}
        return (
            f"# Trial {trial.number} of {self.study.study_name}: {self.main} "
            f"{measured[self.main]:.4e} after {measured['train_seconds']:.1f} s of training, "
            f"the mean of {measured['seeds']} seeds.\n"
            f"# morlax train --config best.yaml --device {device}\n"
        ) + yaml.safe_dump(values, sort_keys=False)

    def importances(self) -> dict[str, float]:
        """Return the share of each option in what makes good trials differ, by PED-ANOVA."""
        complete = [trial for trial in self.finished() if trial.state == State.COMPLETE]
        if len(complete) < FEWEST or len(self.indicators) > 1:
            return {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # says that few trials tell little
            return optuna.importance.get_param_importances(self.study)


def evaluations(config: Config, stopped: Callable[[], bool]) -> Generator[Evaluation, None, None]:
    """Train until max_seconds, and yield evaluations at its start, at its end and between."""
    times = [share * (config.max_seconds or 0.0) for share in (FIRST, REDUCTION * FIRST, 2 / 3)]
    session = Session.of(config, written=False)
    yield from session.training(stopped=stopped, evaluate_at=times)


def _is_of_storage(error: BaseException | None) -> TypeGuard[BaseException]:
    """Return whether Optuna could not write; others name a file, or are no such error."""
    full = isinstance(error, OSError) and error.filename is None
    return full or isinstance(error, optuna.exceptions.StorageInternalError)


def _is_void(trial: Trial) -> bool:
    return trial.state == State.FAIL and "reason" not in trial.user_attrs


def _queue_again(study: optuna.Study, trial: Trial | optuna.Trial, died: bool = True) -> None:
    """Queue a trial that its process has not finished."""
    about = trial.user_attrs
    attributes = {"base": about.get("base", False), "deaths": about.get("deaths", 0) + died}
    study.enqueue_trial(trial.params, attributes)


def _plain(indicators: Mapping[str, float]) -> dict[str, float]:
    values = {**indicators, "hypervolume": indicators[hypervolume_in(indicators)]}
    return {name: float(values[name]) for name in get_args(Indicator)}


class _Lock(optuna.storages.journal.JournalFileSymlinkLock):
    """Whoever gets it first cuts off an incomplete last line, which a full disk leaves."""

    def acquire(self) -> bool:
        super().acquire()
        content = Path(self._lock_target_file).read_bytes()
        if not content.endswith(b"\n"):
            os.truncate(self._lock_target_file, content.rfind(b"\n") + 1)
        return True


def _open(storage: str) -> optuna.storages.BaseStorage:
    """Open a journal file, or the database of a URL, such as postgresql://..."""
    if "://" in storage:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # heartbeats are experimental
            return optuna.storages.RDBStorage(
                storage,
                heartbeat_interval=HEARTBEAT,
                grace_period=SILENCE,
                heartbeat_stale_trial_callback=_queue_again,
            )
    path = Path(storage)
    make_folder(path.parent)
    if path.exists() and not (path.is_file() and JOURNAL.startswith(path.read_bytes()[:11])):
        raise MorlaxError(
            f"cannot use the storage {storage}: it is not a journal of tune. Name a new file, or a "
            "database, such as sqlite:///study.db."
        )
    return optuna.storages.JournalStorage(
        optuna.storages.journal.JournalFileBackend(storage, _Lock(storage))
    )


def _unusable(storage: str, error: BaseException) -> MorlaxError:
    reason = getattr(error, "strerror", None) or str(error).split("\n")[0]
    return MorlaxError(f"cannot use the storage {storage}: {' '.join(reason.split()).rstrip('.')}.")
