"""The search for hyperparameters: a study of Optuna, whose trials train a few times."""

import json
import math
import os
import random
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from statistics import fmean
from typing import Any, get_args

from filelock import FileLock

from ..configuration.config import DRAFT, Config, flat, load_config
from ..configuration.files import merged, nested, space_values, write_yaml
from ..configuration.sections import Indicator
from ..envs import MorlaxError, resolve_device
from ..envs.errors import installation, shortened
from ..envs.naming import title
from ..evaluation.front import hypervolume_in
from ..host.files import AnyPath, attempting, make_folder, write_file, write_rows
from ..host.phases import within
from ..host.resources import release_memory, shortage_of_memory
from ..runs.progress import Evaluation
from ..runs.training import Session

try:
    import optuna
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
    from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock
    from optuna.trial import FrozenTrial as Trial
    from optuna.trial import TrialState as State
except ImportError as error:
    raise MorlaxError(
        f"tuning needs {error.name}, which is not installed: {installation('tune')}."
    ) from None

optuna.logging.set_verbosity(optuna.logging.ERROR)

Distribution = CategoricalDistribution | FloatDistribution | IntDistribution
FIXED = (  # beginnings of what all trials share, as more of the task
    *("env.", "algorithm.", "seed.", "device.", "backend.", "deterministic.", "evaluation."),
    *("max_env_steps.", "max_seconds.", "task.objectives.", "task.shared."),
)
ATTEMPTS = 1000  # draws, of which one must make a valid config
CHANGED = 0.1  # share of the options that a trial changes, beside one
ENOUGH = 20  # trials, from which on TPE draws every second one
FIRST, REDUCTION = 1 / 9, 3  # a third of the trials goes on after 1/9 and 1/3 of the time
FEWEST = 10  # trials, from which on the importance of options is known
SEEDS = 3  # of the base config, and of a trial that stays the best with each of them
JOURNAL = b'{"op_code":'  # begins every line of a journal
FINISHED = State.COMPLETE, State.PRUNED  # also if training failed; others do not count


class Space:
    """Options by dotted name, with the values that trials may give them."""

    def __init__(self, values: Mapping[str, Any], base: Config, source: str):
        if not values:
            raise MorlaxError(f"{source} is empty: name options, such as ppo.epochs: [3, 4].")
        self.base, self.distributions = base, dict[str, Distribution]()
        self._options = flat(base.model_dump(mode="json"))
        self._random = optuna.create_study(sampler=optuna.samplers.RandomSampler())
        for name, choices in values.items():
            try:
                self._add(str(name), choices)
            except (MorlaxError, TypeError, ValueError) as error:
                raise MorlaxError(f"{source}: {name}: {str(error).rstrip('.')}.") from None
        if next(self.draws({}), None) is None:
            raise MorlaxError(f"{ATTEMPTS} draws from {source} do not fit together.")

    def _add(self, name: str, choices: Any) -> None:
        shared = f"{name}.".startswith(FIXED)
        if not shared:
            self.distributions[name] = each = _distribution(choices, self._options.get(name))
            category = isinstance(each, CategoricalDistribution)
            ends = each.choices if category else (each.low, each.high)
            tasks = [self.config({name: value}, DRAFT).task.for_evaluation() for value in ends]
            shared = any(task != self.base.task.for_evaluation() for task in tasks)
        if shared:
            raise ValueError("all trials share it, so that they can be compared: leave it out")

    def config(self, draw: Mapping[str, Any], context: Any = None) -> Config:
        """Return the config of a draw, or raise MorlaxError if values do not fit together."""
        values = self.base.model_dump(mode="json")
        for name, value in draw.items():
            if isinstance(self.distributions[name], FloatDistribution):
                value = float(f"{value:.6g}")  # so that files show 0.15, not 0.15000000000000002
            elif isinstance(value, str) and value.startswith("["):
                value = json.loads(value)
            values = merged(values, nested(name, value))
        return load_config(values, context)

    def draws(self, options: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        """Draw values that fit together, of which most are those of `options`, if any.

        Most random combinations of many options do not train, and a search has few trials.
        """
        for _ in range(ATTEMPTS):
            draw = self._random.ask({**self.distributions}).params
            one = random.choice([*draw])
            kept = (name for name in options if name != one and random.random() >= CHANGED)
            draw |= {name: options[name] for name in kept}
            with suppress(MorlaxError):
                self.config(draw)
                yield draw

    def base_draw(self) -> dict[str, Any]:
        """Return the draw that gives the base config; empty if it lies outside the space."""
        draw = {name: _label(self._options.get(name)) for name in self.distributions}
        try:
            optuna.trial.create_trial(params=draw, distributions={**self.distributions}, value=0.0)
        except ValueError:
            return {}
        return draw


def _distribution(choices: Any, base: Any) -> Distribution:
    if isinstance(choices, dict) and "times" in choices:
        if isinstance(base, bool) or not isinstance(base, int | float):
            raise ValueError(f"{shortened(base)} in the base config has no multiples")
        choices = [base * factor for factor in choices["times"]]
        if not all(0 < multiple < math.inf for multiple in choices):
            raise ValueError("use a list of positive factors, such as {times: [0.5, 1, 2]}")
        if isinstance(base, int):
            choices = [max(1, round(multiple)) for multiple in choices]
    if isinstance(choices, list):
        return CategoricalDistribution([*dict.fromkeys(map(_label, choices))])
    if not isinstance(choices, dict):
        raise ValueError(f"use a list of values or {{low: ..., high: ...}}, not {choices!r}")
    # YAML takes 1e-4 as text
    fields: Any = {key: float(x) if isinstance(x, str) else x for key, x in choices.items()}
    whole = all(isinstance(value, int) for value in fields.values())
    return IntDistribution(**fields) if whole else FloatDistribution(**fields)


def _label(value: Any) -> Any:
    """Return a value in a type that Optuna's storages keep."""
    return json.dumps(value) if isinstance(value, list) else value


class Search:
    """A search for hyperparameters, whose study several processes and machines may share.

    Trial 0 is `config`, and an existing study continues. The `user_attrs` of a trial are its
    `options`, whether it is the `base` config, and what was `measured`: the indicators of its best
    evaluation, `train_seconds` and `env_steps`, means over so many `seeds`; or the `reason` why
    training failed, and Optuna calls it pruned. What Optuna calls failed was interrupted.

    Args are those of `morlax tune`; the space may also be plain values.

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
        self.seconds, self.indicators = seconds, indicators
        self.main = indicators[0] if len(indicators) == 1 else "hypervolume"
        try:
            self.study = optuna.create_study(
                storage=_open(self.storage),
                sampler=optuna.samplers.TPESampler(
                    n_startup_trials=ENOUGH, multivariate=True, constant_liar=True
                ),
                pruner=optuna.pruners.SuccessiveHalvingPruner(
                    max(1, int(1000 * FIRST * seconds)), REDUCTION
                ),
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
        """Queue the base config in a new study, or check that an old one has equal options."""
        plan = flat(self.base.model_dump(mode="json", exclude={"device", "max_seconds"}))
        plan |= {"seconds": self.seconds, "indicators": [*self.indicators]}
        plan["space"] = str(self.space.distributions)
        # in this order: a process that starts at the same time sets the plan before its first trial
        empty, stored = not self.study.trials, self.study.user_attrs.get("plan", {})
        if empty and not stored:
            self.study.set_user_attr("plan", plan)
            self.study.enqueue_trial(self.space.base_draw(), {"base": True})
        elif others := [x for x in {**stored, **plan} if stored.get(x) != plan.get(x)]:
            raise MorlaxError(
                f"the study {self.study.study_name!r} in {self.storage} was started with another "
                f"--{others[0]}: name another --study or --output, or use the same options."
            )

    def finished(self) -> list[Trial]:
        return self.study.get_trials(deepcopy=False, states=FINISHED)

    def running(self) -> list[Trial]:
        return self.study.get_trials(deepcopy=False, states=(State.RUNNING,))

    def ranked(self) -> list[Trial]:
        """Return the complete trials, the best ones first; of several indicators, the front."""
        trials = [trial for trial in self.finished() if trial.state == State.COMPLETE]
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
        """Run trials until so many of the study are finished, those of other processes included.

        `stopped` is asked after each training iteration; true ends the search, and its running
        trial is queued again. `on_trial` is called with each trial once it is written.
        """

        def written(study: optuna.Study, trial: Trial) -> None:
            if trial.state in FINISHED:
                self.write()
                on_trial(trial)

        self._stopped = stopped
        try:
            while not stopped() and (number := len(self.finished())) < trials:
                if number < ENOUGH or number % 2:
                    self._propose()
                self.study.optimize(self._run, 1, catch=_Stopped, callbacks=[written])
        except Exception as error:
            cause: BaseException | None = error  # Optuna may hide it by an error that follows
            while cause is not None:
                # an error of the system that names a file is not of the storage
                full = isinstance(cause, OSError) and cause.filename is None
                if full or isinstance(cause, optuna.exceptions.StorageInternalError):
                    raise _unusable(self.storage, cause.__cause__ or cause) from None
                cause = cause.__context__
            raise

    def _propose(self) -> None:
        """Queue a new trial near the best one."""
        trials = self.study.get_trials(deepcopy=False)
        best = [trial.params for trial in self.study.best_trials] or [self.space.base_draw()]
        tried = [trial.params for trial in trials]
        draws = (x for x in self.space.draws(random.choice(best)) if x not in tried)
        waiting = any(trial.state == State.WAITING for trial in trials)
        if not waiting and (draw := next(draws, None)):
            self.study.enqueue_trial(draw)

    def _run(self, trial: optuna.Trial) -> list[float]:
        """Return the indicators of a trial; none if its options do not fit together."""
        base = trial.user_attrs.get("base", False)
        if not base or self.space.base_draw():
            for name, each in self.space.distributions.items():
                kind = type(each).__name__.removesuffix("Distribution").lower()
                getattr(trial, f"suggest_{kind}")(name, **vars(each))
        try:
            config = self.config(trial)
        except MorlaxError:
            return []
        values = flat(config.model_dump(mode="json"))
        trial.set_user_attr("options", {x: values.get(x) for x in self.space.distributions})
        try:
            return self._train(trial, config)
        except optuna.TrialPruned:
            raise
        except BaseException as error:
            failed = isinstance(error, MorlaxError)
            if reason := str(error) if failed else shortage_of_memory(error):
                trial.set_user_attr("reason", reason)
                raise optuna.TrialPruned from None
            self.study.enqueue_trial(trial.params, {"base": base})
            raise

    def _train(self, trial: optuna.Trial, config: Config) -> list[float]:
        """Train once, or with several seeds if the trial looks like the best one so far.

        The best of many trials is partly luck, which other seeds do not share.
        """
        several, trainings, measured = len(self.indicators) > 1, [], {}
        for number in range(SEEDS):
            with within(f"trial {trial.number}, seed {number + 1}"):
                seeded = config.model_copy(update={"seed": config.seed + number})
                trainings.append(self._train_once(None if several or number else trial, seeded))
            measured = {name: fmean(each[name] for each in trainings) for name in trainings[0]}
            steps = round(measured["env_steps"])
            trial.set_user_attr("measured", {**measured, "env_steps": steps, "seeds": number + 1})
            if trainings[-1]["train_seconds"] < self.seconds:
                raise optuna.TrialPruned
            best = [self._score(each.user_attrs["measured"]) for each in self.ranked()[:1]]
            beaten = best and self._score(measured) <= best[0]
            if several or (beaten and not trial.user_attrs.get("base")):
                break
        return [measured[name] for name in self.indicators]

    def _train_once(self, trial: optuna.Trial | None, config: Config) -> dict[str, float]:
        """Return the numbers of the best evaluation; `trial`, if any, may be pruned."""
        release_memory()
        done, numbers = list[Evaluation](), {}
        with closing(evaluations(config, self._stopped)) as evaluated:
            for evaluation in evaluated:
                done.append(evaluation)
                best = max(done, key=lambda each: self._score(_plain(each.measured)))
                seconds, steps = evaluation.train_seconds, evaluation.env_steps
                numbers = {**_plain(best.indicators), "train_seconds": seconds, "env_steps": steps}
                if trial is not None and steps and seconds < self.seconds:
                    trial.report(numbers[self.main], int(1000 * seconds))
                    if trial.should_prune() and not trial.user_attrs.get("base"):
                        return numbers
        if numbers.get("train_seconds", 0.0) < self.seconds:
            raise _Stopped
        return numbers

    def write(self) -> None:
        """Write trials.csv and, once a trial is complete, best.yaml, or raise MorlaxError."""
        measured = (*get_args(Indicator), "train_seconds", "env_steps", "seeds")
        names = ("number", "state", "base", *measured, *self.space.distributions, "reason")
        rows = [names]
        for trial in self.finished():
            row = {**trial.user_attrs, "number": trial.number, "state": state_of(trial)}
            row |= row["options"] | row.get("measured", {})
            rows.append(tuple(row.get(name, "") for name in names))
        make_folder(self.folder)
        # processes must not replace newer files by older ones
        with attempting(f"write to {self.folder}"), FileLock(self.folder / ".lock"):
            write_rows(self.folder / "trials.csv", rows)
            for best in self.ranked()[:1]:
                values = best.user_attrs["measured"]
                comment = (
                    f"# Trial {best.number} of {self.study.study_name}: {self.main} "
                    f"{values[self.main]:.4e}, the mean of {values['seeds']} seeds.\n"
                )
                where = {"device": resolve_device(self.base.device).type, "backend": None}
                config = self.config(best).model_copy(update=where)
                write_file(self.folder / "best.yaml", comment + write_yaml(config))

    def heads(self) -> str:
        """Return what stands above the numbers of a `line`."""
        names = "  ".join(f"{name[:11]:>11}" for name in self.indicators)
        return f"trial  state     {names}  ratio  changed options"

    def line(self, trial: Trial) -> str:
        """Return a finished trial as text: its indicators, also beside the base config's."""
        text, measured = trial.user_attrs.get("reason", ""), trial.user_attrs.get("measured")
        if measured and not text:
            bases = (each.user_attrs for each in self.ranked() if each.user_attrs.get("base"))
            volume = next((base["measured"][self.main] for base in bases), 0.0)
            ratio = f"{measured[self.main] / volume:.2f}" if volume > 0 else "-"
            usual = flat(self.base.model_dump(mode="json"))
            changed = [
                f"{name.rpartition('.')[2]}={f'{value:.3g}' if isinstance(value, float) else value}"
                for name, value in trial.user_attrs["options"].items()
                if value != usual.get(name)
            ]
            values = "  ".join(f"{measured[name]:11.4e}" for name in self.indicators)
            text = f"{values}  {ratio:>5}  {' '.join(changed) or 'the base config'}"
        return f"{trial.number:5d}  {state_of(trial):8}  {text}"

    def importances(self) -> dict[str, float]:
        """Return the share of each option in what makes good trials differ, by PED-ANOVA."""
        if len(self.ranked()) < FEWEST or len(self.indicators) > 1:
            return {}
        with warnings.catch_warnings(action="ignore"):  # that few trials tell little
            return optuna.importance.get_param_importances(self.study)


def state_of(trial: Trial) -> str:
    return "fail" if "reason" in trial.user_attrs else trial.state.name.lower()


def evaluations(config: Config, stopped: Callable[[], bool]) -> Generator[Evaluation, None, None]:
    """Train until max_seconds, and yield evaluations at its start, at its end and between."""
    times = [share * (config.max_seconds or 0.0) for share in (FIRST, REDUCTION * FIRST, 2 / 3)]
    return Session.of(config, written=False).training(stopped=stopped, evaluate_at=times)


class _Stopped(Exception):
    """The search ends while a trial runs."""


def _plain(indicators: Mapping[str, float]) -> dict[str, float]:
    values = {**indicators, "hypervolume": indicators[hypervolume_in(indicators)]}
    return {name: float(values[name]) for name in get_args(Indicator)}


class _Lock(JournalFileSymlinkLock):
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
        with warnings.catch_warnings(action="ignore"):  # heartbeats are experimental
            again = optuna.storages.RetryHeartbeatStaleTrialCallback(max_retry=1)
            beats: Any = {"heartbeat_interval": 60, "grace_period": 600}
            return optuna.storages.RDBStorage(
                storage, **beats, heartbeat_stale_trial_callback=again
            )
    path = Path(storage)
    make_folder(path.parent)
    if path.exists() and not (path.is_file() and JOURNAL.startswith(path.read_bytes()[:11])):
        raise MorlaxError(f"cannot use the storage {storage}: it is not a journal of tune.")
    return optuna.storages.JournalStorage(JournalFileBackend(storage, _Lock(storage)))


def _unusable(storage: str, error: BaseException) -> MorlaxError:
    reason = getattr(error, "strerror", None) or str(error).split("\n")[0]
    return MorlaxError(f"cannot use the storage {storage}: {' '.join(reason.split()).rstrip('.')}.")
