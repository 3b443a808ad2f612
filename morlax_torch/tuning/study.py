"""A study that several processes and machines may share."""

import os
import socket
from typing import Any, NamedTuple

from ..configuration.config import Config, flat
from ..envs import MorlaxError
from ..envs.naming import title
from ..host.files import runs
from .plan import Plan, make_pruner, step
from .sampling import ATTEMPTS, Sampler
from .storage import open_storage, optuna, quiet

RUNNING, WAITING, FAIL, PRUNED, COMPLETE = (
    getattr(optuna.trial.TrialState, name)
    for name in ("RUNNING", "WAITING", "FAIL", "PRUNED", "COMPLETE")
)
MOST_DEATHS = 2  # processes that may die in the same trial before it counts as failed


class Result(NamedTuple):
    number: int
    state: str  # complete, pruned or failed
    base: bool  # whether it is the unchanged base config
    config: Config
    options: dict[str, Any]  # of the space, by name
    indicators: dict[str, float] = {}  # of its best evaluation; empty if it failed
    train_seconds: float = 0.0
    env_steps: int = 0
    seeds: int = 1  # that numbers are means of
    reason: str = ""  # of a failure


class Claim(NamedTuple):
    """A trial that this process runs."""

    trial: optuna.Trial
    base: bool
    config: Config
    deaths: int  # of processes that ran it before


class Study:
    """A study, which several processes and machines may share.

    A trial that fails stores its reason. A failed trial without one is void: it was interrupted,
    and its options are queued again. `storage` and `name` are those of `tune`.

    Raises:
        MorlaxError: the storage cannot be used, or has a study of this name with another plan.
    """

    def __init__(self, plan: Plan, storage: str, name: str | None = None):
        self.plan, self.storage, self.name = plan, storage, name or title(plan.base.env)
        self._space, seconds = plan.space, plan.base.max_seconds or 0.0
        self._base = plan.space.drawn(plan.base)
        self._invalid: MorlaxError | None = None
        sampler = Sampler(plan, self._base, self._valid)
        with quiet():
            self._try_space(sampler)
            place = open_storage(storage)
            try:
                self._study = optuna.create_study(
                    storage=place,
                    sampler=sampler,
                    pruner=make_pruner(seconds),
                    study_name=self.name,
                    directions=plan.directions,
                    load_if_exists=True,
                )
                self._check_plan()
            except (ValueError, KeyError, OSError) as error:
                raise MorlaxError(f"cannot use the storage {storage}: {error}.") from None

    def _try_space(self, sampler: Sampler) -> None:
        """Raise MorlaxError before training if almost no draw from the space is a valid config."""
        attempt = optuna.create_study(sampler=sampler)
        attempt.ask()  # the base config
        drawn = attempt.ask(self._space.distributions).params
        if not self._valid(drawn):
            raise self._misfit()

    def _misfit(self) -> MorlaxError:
        return MorlaxError(
            f"{ATTEMPTS} draws from the search space do not fit together, the last one because "
            f"{self._invalid}"
        )

    def _check_plan(self) -> None:
        # in this order: a process that starts at the same time sets the plan before its first trial
        empty = not self._study.get_trials(deepcopy=False)
        own, known = self.plan.description(), self._study.user_attrs.get("plan")
        if known is None and empty:
            self._study.set_user_attr("plan", own)
        elif known is None:
            raise MorlaxError(f"the study {self.name!r} in {self.storage} is of another program.")
        one, other = flat(known or own), flat(own)
        for name in (key for key in {**one, **other} if one.get(key) != other.get(key)):
            raise MorlaxError(
                f"the study {self.name!r} in {self.storage} was started with another "
                f"{_option(name)}: choose another --study or --output, or start it with the same "
                "options."
            )

    def _valid(self, drawn: dict[str, Any]) -> bool:
        try:
            self._space.config(self.plan.base, drawn)
            return True
        except MorlaxError as error:
            self._invalid = error
            return False

    def claim(self, most: int) -> Claim | None:
        """Start a trial, unless `most` have been started; raises MorlaxError if none fits."""
        with quiet():
            self._revive()
            if len([t for t in self._counted() if t.state != WAITING]) >= most:
                return None
            trial = self._study.ask()
            # the storage orders trials, so processes that start one at the same time agree
            if len([t for t in self._counted() if t.number < trial.number]) >= most:
                self._study.tell(trial, state=FAIL)
                return None
            base = trial.number == 0 or trial.user_attrs.get("base", False)
            about = {"host": socket.gethostname(), "process": os.getpid(), "base": base}
            for name, value in about.items():
                trial.set_user_attr(name, value)
            if self._base or not base:
                for name, distribution in self._space.distributions.items():
                    _suggest(trial, name, distribution)
            if not base and not self._valid(trial.params):
                self._study.tell(trial, state=FAIL)
                raise self._misfit()
            config = self._config(trial, base)
            return Claim(trial, base, config, trial.user_attrs.get("deaths", 0))

    def _config(self, trial: Any, base: bool) -> Config:
        return self.plan.base if base else self._space.config(self.plan.base, trial.params)

    def prunes(self, claim: Claim, value: float, train_seconds: float) -> bool:
        """Report the main indicator of a running trial, and return whether to stop it."""
        if len(self.plan.indicators) > 1:
            return False
        with quiet():
            claim.trial.report(value, step(train_seconds))
            return claim.trial.should_prune() and not claim.base

    def looks_best(self, claim: Claim, indicators: dict[str, float]) -> bool:
        """Return whether a trial is the base config, or better than all complete trials."""
        if len(self.plan.indicators) > 1:
            return False
        best, score = self.ranked()[:1], self.plan.sign * indicators[self.plan.main]
        return claim.base or not best or score > self.score(best[0])

    def finish(
        self,
        claim: Claim,
        indicators: dict[str, float],
        train_seconds: float,
        env_steps: int,
        seeds: int = 1,
        pruned: bool = False,
    ) -> Result:
        found = {
            "train_seconds": train_seconds,
            "env_steps": env_steps,
            "seeds": seeds,
            "indicators": indicators,
        }
        for name, value in found.items():
            claim.trial.set_user_attr(name, value)
        values = [indicators[name] for name in self.plan.indicators]
        return self._tell(claim, *((PRUNED, None) if pruned else (COMPLETE, values)))

    def fail(self, claim: Claim, reason: str) -> Result:
        claim.trial.set_user_attr("reason", reason)
        return self._tell(claim, FAIL, None)

    def _tell(self, claim: Claim, state: Any, values: list[float] | None) -> Result:
        with quiet():
            return self._result(self._study.tell(claim.trial, values, state))

    def put_back(self, claim: Claim) -> None:
        self._again(claim.trial.number, claim.trial.params, claim.base, claim.deaths)

    def _again(self, number: int, params: dict[str, Any], base: bool, deaths: int) -> None:
        with quiet():
            try:
                self._study.tell(number, state=FAIL)
            except (ValueError, optuna.exceptions.UpdateFinishedTrialError):
                return  # another process has told it
            attributes = {"base": base, "deaths": deaths}
            self._study.enqueue_trial(params, attributes)

    def _revive(self) -> None:
        """Queue the trials of this machine's processes that are gone."""
        for trial in self._study.get_trials(deepcopy=False, states=(RUNNING,)):
            about = trial.user_attrs
            if about.get("host") == socket.gethostname() and not runs(about.get("process", 0)):
                base, deaths = about.get("base", False), about.get("deaths", 0) + 1
                self._again(trial.number, trial.params, base, deaths)

    def _counted(self) -> list[optuna.trial.FrozenTrial]:
        trials = self._study.get_trials(deepcopy=False)
        return [t for t in trials if t.state != FAIL or "reason" in t.user_attrs]

    def results(self) -> list[Result]:
        return [self._result(t) for t in self._counted() if t.state.is_finished()]

    def _result(self, trial: optuna.trial.FrozenTrial) -> Result:
        about, base = trial.user_attrs, trial.user_attrs.get("base", False)
        config = self._config(trial, base)
        values = flat(config.model_dump(mode="json"))
        state = {COMPLETE: "complete", PRUNED: "pruned", FAIL: "failed"}[trial.state]
        options = {name: values[name] for name in self._space.parameters}
        known = {name: about[name] for name in Result._field_defaults if name in about}
        return Result(trial.number, state, base, config, options, **known)

    def ranked(self) -> list[Result]:
        """Return the complete trials, the best ones first.

        Of several indicators, only non-dominated trials, by hypervolume.
        """
        found = [result for result in self.results() if result.state == "complete"]
        if len(self.plan.indicators) > 1:
            with quiet():
                best = {trial.number for trial in self._study.best_trials}
            found = [result for result in found if result.number in best]
        return sorted(found, key=self.score, reverse=True)

    def score(self, result: Result) -> float:
        """Return the main indicator of a trial that has not failed, negated if lower is better."""
        return self.plan.sign * result.indicators[self.plan.main]

    def base_result(self) -> Result | None:
        """Return the trial of the base config, once it is complete."""
        return next((r for r in self.results() if r.base and r.state == "complete"), None)

    def trials_with_options(self) -> list[optuna.trial.FrozenTrial]:
        """Return the complete and pruned trials whose options are all in the space."""
        found = self._study.get_trials(deepcopy=False, states=(COMPLETE, PRUNED))
        return [trial for trial in found if set(trial.params) == set(self._space.parameters)]


def _option(name: str) -> str:
    """Return the option that sets a value of a plan's description."""
    if name.startswith("space."):
        return "--space"
    own = {"config.max_seconds": "--seconds", "indicators": "--indicators"}
    return own.get(name, name.removeprefix("config."))


def _suggest(trial: optuna.Trial, name: str, distribution: Any) -> None:
    if isinstance(distribution, optuna.distributions.CategoricalDistribution):
        trial.suggest_categorical(name, distribution.choices)
        return
    whole = isinstance(distribution, optuna.distributions.IntDistribution)
    suggest = trial.suggest_int if whole else trial.suggest_float
    steps = {"step": distribution.step, "log": distribution.log}
    suggest(name, distribution.low, distribution.high, **steps)
