"""The search for hyperparameters: a study of Optuna, whose trials train a few times."""

import json
import random
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ..configuration.config import DRAFT, Config, flat, load_config
from ..configuration.files import merged, nested, write_yaml
from ..envs import MorlaxError, resolve_device
from ..envs.errors import installation
from ..host.files import AnyPath, attempting, make_folder, read, write_file, write_rows
from ..host.phases import within
from ..host.resources import release_memory, shortage_of_memory
from ..runs.training import Session

try:
    import optuna
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
    from optuna.samplers import RandomSampler, TPESampler
    from optuna.storages.journal import JournalFileBackend, JournalStorage
    from optuna.study import StudyDirection
    from optuna.trial import FrozenTrial, TrialState
except ImportError as error:
    needed = f"this search needs {error.name}, which is not installed: {installation('tune')}."
    raise MorlaxError(needed) from None

optuna.logging.set_verbosity(optuna.logging.ERROR)

Callback = Callable[[optuna.Study, FrozenTrial], None]
FIXED = {"env", "algorithm", "seed", "device", "backend", "deterministic", "evaluation", "task"}
FIXED |= {"max_env_steps", "max_seconds"}  # options and sections that all trials share
CHANGED = 0.15  # share of the options that a trial near the best one changes
ENOUGH = 20  # trials, from which on TPE draws every second one
SEEDS = 3  # of the base config, and of a trial that stays the best with each of them
FINISHED = TrialState.COMPLETE, TrialState.PRUNED  # also if training failed; others do not count


class Search:
    """A search for hyperparameters, which continues the study in the output folder, if any.

    Trial 0 is `config`. The value of a trial is the hypervolume of its best evaluation, the mean
    over so many "seeds" of its `user_attrs`. If training fails, the trial is pruned and has a
    "reason". Raises MorlaxError if the space or the study in the folder cannot be used.
    """

    def __init__(self, config: Config, space: Mapping[str, Any], output: AnyPath, seconds: float):
        limits = {"max_seconds": seconds, "max_env_steps": None, "evaluation": {"every": None}}
        self.base = load_config(merged(config.model_dump(mode="json"), limits))
        options = flat(self.base.model_dump(mode="json", exclude={"device", "max_seconds"}))
        space = distributions(space, self.base)
        self.space, self.seconds, self.folder = space, seconds, Path(output)
        self.base_draw = {x: getattr(each, "choices", [options[x]])[0] for x, each in space.items()}
        self.study = _open(self.folder)
        plan = {**options, "space": str(self.space), "seconds": seconds}
        stored = self.study.user_attrs.get("plan")
        if stored is None:
            self.study.enqueue_trial(self.base_draw, skip_if_exists=True)
            self.study.set_user_attr("plan", plan)
        elif others := [x for x in {**stored, **plan} if stored.get(x) != plan.get(x)]:
            raise MorlaxError(
                f"the study in {output} has another --{others[0]}: keep it, or change --output."
            )

    def finished(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=FINISHED)

    def ranked(self) -> list[FrozenTrial]:
        """Return the complete trials, the best ones first."""
        trials = self.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        return sorted(trials, key=lambda trial: trial.value or 0.0, reverse=True)

    def run(self, trials: int, stopped: Callable[[], bool] = bool, *callbacks: Callback) -> None:
        """Run trials until so many are finished, by all processes, or until `stopped`."""
        self._stopped = stopped
        try:
            with suppress(InterruptedError):
                while not stopped() and (number := len(self.finished())) < trials:
                    if number < ENOUGH or number % 2:
                        self._propose()
                    self.study.optimize(self._run, 1, callbacks=[self.write, *callbacks])
        except (
            AssertionError,
            OSError,
        ) as error:  # on a full disk, Optuna raises one over the other
            cause = error.__context__ if isinstance(error, AssertionError) else error
            if isinstance(cause, OSError) and cause.filename is None:
                with attempting(f"write to {self.folder}"):
                    raise cause from None
            raise

    def _propose(self) -> None:
        """Queue a trial near the best one: most random combinations of many options fail."""
        near = self.ranked()[0].params if self.ranked() else self.base_draw
        tried = [trial.params for trial in self.study.trials]
        if self.study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            return
        draws = optuna.create_study(sampler=RandomSampler())
        for _ in range(100):
            drawn = draws.ask({**self.space}).params
            draw = near | {name: drawn[name] for name in near if random.random() < CHANGED}
            if draw not in tried:
                self.study.enqueue_trial(draw)
                break

    def _run(self, trial: optuna.Trial) -> float:
        for name, each in self.space.items():
            kind = type(each).__name__.removesuffix("Distribution").lower()
            getattr(trial, f"suggest_{kind}")(name, **vars(each))
        try:
            return self._train(trial, changed(self.base, trial.params))
        except (MorlaxError, MemoryError, RuntimeError) as error:
            reason = str(error) if isinstance(error, MorlaxError) else shortage_of_memory(error)
            if reason is None:
                raise
            trial.set_user_attr("reason", reason)
            raise optuna.TrialPruned from None

    def _train(self, trial: optuna.Trial, config: Config) -> float:
        """Return the hypervolume, the mean over several seeds if the trial looks like the best.

        The best of many trials is partly luck, which other seeds do not share.
        """
        times, base = [self.seconds * n / 9 for n in (1, 3, 6)], trial.params == self.base_draw
        reached = list[float]()
        while len(reached) < SEEDS:
            release_memory()
            seeded = config.model_copy(update={"seed": config.seed + len(reached)})
            session, hypervolume, ninths = Session.of(seeded, written=False), 0.0, 0
            with within(f"trial {trial.number}, seed {len(reached) + 1}"):
                for evaluation in session.training(stopped=self._stopped, evaluate_at=times):
                    hypervolume = evaluation.hypervolume if evaluation.best else hypervolume
                    ninths = int(9 * evaluation.train_seconds / self.seconds)
                    if ninths < 9 and not reached:
                        trial.report(hypervolume, ninths)
                        if trial.should_prune() and not base:
                            raise optuna.TrialPruned
            if ninths < 9:
                self.study.enqueue_trial(trial.params)  # to be run when the search goes on
                raise InterruptedError
            reached.append(hypervolume)
            trial.set_user_attr("seeds", len(reached))
            if not base and self.ranked() and (self.ranked()[0].value or 0.0) >= fmean(reached):
                break
        return fmean(reached)

    def write(self, *_: object) -> None:
        """Write trials.csv and, once a trial is complete, best.yaml."""
        names = "number", "state", "hypervolume", "seeds", *self.space, "reason"
        rows: list[Sequence[Any]] = [names]
        for trial in self.finished():
            row = trial.user_attrs | trial.params | {"number": trial.number}
            row |= {"state": trial.state.name.lower(), "hypervolume": trial.value}
            rows.append([row.get(name, "") for name in names])
        write_rows(self.folder / "trials.csv", rows)
        for best in self.ranked()[:1]:
            text = f"# Trial {best.number} of {len(rows) - 1}: hypervolume {best.value:.4e}\n"
            where = {"device": resolve_device(self.base.device).type, "backend": None}
            text += write_yaml(changed(self.base, best.params).model_copy(update=where))
            write_file(self.folder / "best.yaml", text)


def _open(folder: Path) -> optuna.Study:
    make_folder(folder)
    path = folder / "journal.log"
    lines = read(path, "journal").splitlines(keepends=True) if path.exists() else []
    if not all(line.count(b'{"op_code":') == 1 and line.endswith(b"}\n") for line in lines):
        raise MorlaxError(f"{path} is not a journal of tune, or has damaged lines: delete them.")
    with attempting(f"write {path}"):
        return optuna.create_study(
            storage=JournalStorage(JournalFileBackend(str(path))),
            sampler=TPESampler(n_startup_trials=ENOUGH, multivariate=True),
            # a third of the trials goes on after one ninth and three ninths of the time
            pruner=optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=3),
            direction="maximize",
            study_name="tune",
            load_if_exists=True,
        )


def distributions(values: Mapping[str, Any], base: Config) -> dict[str, Any]:
    """Return Optuna's distributions of a search space, with the base config's values in each."""
    if not values:
        raise MorlaxError("the search space is empty: name options, such as ppo.epochs: [3, 4].")
    space, options = {}, flat(base.model_dump(mode="json"))
    for name, choices in ((str(key), value) for key, value in values.items()):
        try:
            if name.partition(".")[0] in FIXED:
                raise ValueError("all trials share it, so that they can be compared: leave it out")
            space[name] = each = _distribution(choices, options.get(name))
            for value in vars(each).get("choices") or (each.low, each.high):
                changed(base, {name: value}, DRAFT)
        except (MorlaxError, TypeError, ValueError) as error:
            raise MorlaxError(f"the search space: {name}: {str(error).rstrip('.')}.") from None
    return space


def _distribution(choices: Any, base: Any) -> Any:
    if isinstance(choices, dict) and "times" in choices:
        multiples = [base * factor for factor in choices["times"]]
        choices = [max(1, round(x)) if isinstance(base, int) else x for x in multiples]
    if isinstance(choices, list):
        labels = [json.dumps(x) if isinstance(x, list) else x for x in (base, *choices)]
        return CategoricalDistribution([*dict.fromkeys(labels)])
    if not isinstance(choices, dict) or not isinstance(base, int | float):
        raise ValueError(f"for {base} in the base config, use a list of values")
    # YAML takes 1e-4 as text
    fields: Any = {key: float(x) if isinstance(x, str) else x for key, x in choices.items()}
    integer = all(isinstance(value, int) for value in (base, *fields.values()))
    kind = IntDistribution if integer else FloatDistribution
    each = kind(**fields)
    return kind(**fields | {"low": min(each.low, base), "high": max(each.high, base)})


def changed(base: Config, draw: Mapping[str, Any], context: Any = None) -> Config:
    """Return the base config with drawn values, or raise MorlaxError if they do not fit."""
    values = base.model_dump(mode="json")
    for name, value in draw.items():
        value = json.loads(value) if str(value).startswith("[") else value
        values = merged(values, nested(name, value))
    return load_config(values, context)


def evolution(
    ranges: Mapping[str, FloatDistribution],
    starts: np.ndarray,
    objectives: int,
    population: int,
    seed: int,
) -> optuna.Study:
    """Return a study of NSGA-II, whose first generation has the first of the starts (k, d)."""
    sampler = optuna.samplers.NSGAIISampler(population_size=population, seed=seed)
    directions = [StudyDirection.MAXIMIZE] * objectives
    study = optuna.create_study(directions=directions, sampler=sampler)
    for start in starts[:population].tolist():
        study.enqueue_trial(dict(zip(ranges, start, strict=True)))
    return study


def generation(
    study: optuna.Study, ranges: Mapping[str, FloatDistribution], population: int
) -> tuple[list[optuna.Trial], np.ndarray]:
    """Return the next trials of an evolution, and their values (population, d)."""
    trials = [study.ask({**ranges}) for _ in range(population)]
    for trial in trials:
        _ = trial.relative_params  # else Optuna 5 leaves queued trials out of the population
    return trials, np.array([[trial.params[name] for name in ranges] for trial in trials])
