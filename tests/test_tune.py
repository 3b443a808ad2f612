"""Hyperparameter search: trials, their files, sharing, interruption, failures and bad spaces."""

import csv
import json
import math
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml

pytest.importorskip("optuna", reason="needs the extra tune")

from morlax_torch import MorlaxError, config_for
from morlax_torch.commands import train as train_command
from morlax_torch.commands import tune
from morlax_torch.commands.terminal import cli, tune_arguments
from morlax_torch.commands.terminal.tune_display import TuneDisplay
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.files import space_values
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run
from morlax_torch.runs.progress import Evaluation
from morlax_torch.train import train
from morlax_torch.tuning import trial as trial_module
from morlax_torch.tuning.plan import Indicator, Plan
from morlax_torch.tuning.results import importances, write_results
from morlax_torch.tuning.searching import tune as search
from morlax_torch.tuning.storage import optuna
from morlax_torch.tuning.study import Claim, Study
from morlax_torch.tuning.workers import MARK, places

TINY = (
    *("--env", "hopper", "--device", "cpu", "--worlds", "32", "--horizon", "5"),
    *("--sampling.clusters", "8", "--ppo.minibatches", "2", "--evaluation.tradeoffs", "7"),
    *("--task.episode-length", "20"),
)
SPACE = "ppo.learning_rate: {low: 1e-4, high: 3e-3, log: true}\nppo.epochs: [2, 3]\n"
VALUES: dict[str, Any] = yaml.safe_load(SPACE)


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch) -> Path:
    (tmp_path / "space.yaml").write_text(SPACE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tiny(**changes: Any) -> Config:
    return tune_arguments.read(TINY).config.model_copy(update=changes)


def typed(*arguments: str) -> list[str]:
    command = [sys.executable, "-m", "morlax_torch", "tune", *TINY, "--seconds", "0.1"]
    return [*command, "--space", "space.yaml", *arguments]


def run(monkeypatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", typed(*arguments)[3:])
    cli.run(tune.command)


def refused(monkeypatch, capsys, *arguments: str) -> str:
    """Return the sentence with which the command ends."""
    with pytest.raises(SystemExit) as ended:
        run(monkeypatch, *arguments)
    assert ended.value.code == 2
    return " ".join(capsys.readouterr().err.split())


def rows(folder: Path = Path("tuning/hopper")) -> list[dict[str, str]]:
    with (folder / "trials.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def scripted(study: Study, claim: Claim, curve: list[float]) -> str:
    """Let a trial reach the values of a curve at even times; returns its state."""
    seconds, best = claim.config.max_seconds or 0.0, -math.inf
    for number, value in enumerate(curve, 1):
        best, now = max(best, value), seconds * number / len(curve)
        indicators = {"hypervolume": best, "expected_utility": -value}
        if number < len(curve) and study.prunes(claim, best, now):
            return study.finish(claim, indicators, now, number, pruned=True).state
    return study.finish(claim, indicators, seconds, len(curve)).state


def study_at(
    path: Path, *indicators: Any, base: Config | None = None, seconds: float = 9.0, **space: Any
) -> Study:
    chosen = indicators or ("hypervolume",)
    plan = Plan.of(base or tiny(), space or VALUES, seconds, chosen, "the search space")
    return Study(plan, str(path / "journal.log"))


def claimed(study: Study, most: int = 1000) -> Claim:
    claim = study.claim(most)
    assert claim is not None
    return claim


@pytest.mark.slow
def test_a_search_writes_trials_and_a_config_that_trains(workplace, monkeypatch, capsys):
    run(monkeypatch, "--trials", "3")
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if not line.startswith("next: ")) <= 80
    assert "3 of 3 trials done" in lines and "base" in "".join(lines)
    found = rows()
    assert [row["number"] for row in found] == ["0", "1", "2"]
    assert found[0]["base"] == "True" and found[0]["ppo.learning_rate"] == "0.0005"
    assert all(float(row["hypervolume"]) > 0 and int(row["env_steps"]) > 0 for row in found)
    complete = [row for row in found if row["state"] == "complete"]
    best = max(complete, key=lambda row: float(row["hypervolume"]))
    words = "--config tuning/hopper/best.yaml --device cpu --max-seconds 0.1 --output run"
    train_command.command(words.split())
    config = Run.open(Path("run")).config()
    assert config.ppo.learning_rate == float(best["ppo.learning_rate"])
    assert (config.worlds, config.task.episode_length) == (32, 20)
    assert config.max_env_steps is None

    run(monkeypatch, "--trials", "3")
    assert "3 of them done" in capsys.readouterr().out
    assert rows() == found


def test_best_yaml_of_an_own_robot_trains_with_the_same_config(workplace):
    robot = "from morlax_torch import envs\n\n\nclass Mine(envs.get('hopper')):\n    pass\n"
    (workplace / "mine.py").write_text(robot)
    base = config_for("mine.py:Mine", device="cpu", worlds=32, evaluation={"tradeoffs": 5})
    objectives = {"a": {"run": 1.0}, "b": {"jump": 2.0}}
    base = base.model_copy(update={"task": base.task.model_copy(update={"objectives": objectives})})
    study = study_at(workplace, base=base, **{"ppo.clip": [0.3]})
    assert scripted(study, claimed(study), [1.0]) == "complete"
    second = claimed(study)
    scripted(study, second, [2.0] * 9)
    write_results(study, workplace)
    text = (workplace / "best.yaml").read_text()
    assert yaml.safe_load(text)["env"] == f"{workplace}/mine.py:Mine"
    config = train_command.read(["--config", "best.yaml", "--device", "cpu"])[0]
    left_out = {"device", "backend"}
    assert config.model_dump(exclude=left_out) == second.config.model_dump(exclude=left_out)
    assert config.task.objectives == objectives and config.ppo.clip == 0.3


def test_only_options_that_differ_between_trials_are_shown(tmp_path, capsys):
    study = study_at(tmp_path, **{"ppo.clip": [0.3], "ppo.epochs": [4]})
    for curve in ([1.0], [2.0] * 9):
        scripted(study, claimed(study), curve)
    display = TuneDisplay(study, tmp_path, 2)
    for number in (0, 1):
        display.finished_by_worker(number)
    display.ended("")
    first, second, *table = (line.split() for line in capsys.readouterr().out.splitlines())
    assert first[4:] == ["the", "base", "config"] and second[4:] == ["clip=0.3"]
    assert ["ppo.clip", "0.2", "0.3"] in table
    assert not any("ppo.epochs" in line for line in table)


@pytest.mark.slow
def test_searches_share_the_trials_of_one_storage(workplace):
    study = None
    for folder, trials in (("one", 2), ("other", 4)):
        study = search(
            tiny(), "space.yaml", folder, trials=trials, seconds=0.05, storage="shared.log"
        )
    found = study.results()
    assert [result.base for result in found] == [True, False, False, False]
    assert len({tuple(result.options.values()) for result in found}) == 4


@pytest.mark.slow
def test_workers_share_a_study_and_a_signal_ends_all_of_them(workplace):
    command = typed("--trials", "500", "--workers", "2")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    table = Path("tuning/hopper/trials.csv")
    while process.poll() is None and (not table.exists() or len(table.read_text()) < 300):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=100)[0]
    assert process.returncode == 130, told
    assert "Traceback" not in told and told.count("starting") == 0
    assert told.count("continue: python -m morlax_torch tune --env hopper") == 1
    assert "the base config" in told and MARK not in told
    assert told.count("of 500 trials done") == 1 and Path("tuning/hopper/best.yaml").exists()
    drawn = [(row["ppo.learning_rate"], row["ppo.epochs"]) for row in rows()]
    assert len(set(drawn)) == len(drawn)
    assert [row["base"] for row in rows()].count("True") == 1


def test_an_interrupted_trial_is_run_again(workplace):
    asked: list[int] = []

    def stopped() -> bool:
        asked.append(1)
        return len(asked) > 3

    study = search(tiny(), VALUES, trials=3, seconds=100.0, stopped=stopped)
    assert study.results() == []
    first = claimed(study)
    assert first.base and first.trial.number == 1
    study.put_back(first)
    assert study.results() == []
    assert claimed(study).config == first.config


def test_the_trial_of_a_killed_process_is_run_again(workplace):
    study = study_at(workplace)
    for deaths in range(3):
        claim = claimed(study)
        assert claim.base and claim.deaths == deaths
        claim.trial.set_user_attr("process", 2**22 + 1)  # larger than any process
    failed = trial_module.run_trial(study, claim, lambda: False)
    assert failed is not None and failed.reason == "2 processes died in it."
    assert [result.state for result in study.results()] == ["failed"]


def test_a_dead_trial_that_another_process_has_queued_meanwhile_is_left_to_it(
    workplace, monkeypatch
):
    study = study_at(workplace)
    claimed(study).trial.set_user_attr("process", 2**22 + 1)

    def told(*_: Any, **__: Any) -> None:
        raise optuna.exceptions.UpdateFinishedTrialError

    monkeypatch.setattr(study._study, "tell", told)
    assert not claimed(study).base
    assert len(study._study.get_trials()) == 2


def failing_with(monkeypatch, *errors: Exception) -> None:
    """Let the first trials fail."""
    usual, left = trial_module.evaluations, iter(errors)

    def evaluations(config: Config, stopped: Any) -> Any:
        error = next(left, None)
        if error is not None:
            raise error
        return usual(config, stopped)

    monkeypatch.setattr(trial_module, "evaluations", evaluations)


def test_a_trial_that_fails_does_not_end_the_study(workplace, monkeypatch, capsys):
    failing_with(monkeypatch, MorlaxError("the loss became nan."), MemoryError())
    run(monkeypatch, "--trials", "3")
    states = [(row["state"], row["reason"]) for row in rows()]
    assert states[0] == ("failed", "the loss became nan.")
    assert states[1][1].startswith("the memory is full")
    assert states[2] == ("complete", "")
    assert "failed    the loss became nan." in capsys.readouterr().out


def test_a_study_whose_trials_all_fail_says_so(workplace, monkeypatch, capsys):
    failing_with(monkeypatch, MorlaxError("it is wrong."), MorlaxError("it is broken."))
    told = refused(monkeypatch, capsys, "--trials", "2")
    assert "every trial failed, the last one because: it is broken." in told


def test_other_errors_are_not_hidden_and_lose_no_trial(workplace, monkeypatch):
    failing_with(monkeypatch, ValueError("a bug of the task"))
    with pytest.raises(ValueError, match="a bug"):
        search(tiny(), VALUES, trials=1, seconds=0.05)
    assert len(search(tiny(), VALUES, trials=1, seconds=0.05).results()) == 1


def test_clearly_worse_trials_are_pruned_at_a_ninth_and_a_third_of_the_time(tmp_path):
    study = study_at(tmp_path)
    good = [100.0 * n for n in range(1, 10)]
    assert scripted(study, claimed(study), good) == "complete"
    assert scripted(study, claimed(study), [1.0] * 9) == "pruned"
    assert scripted(study, claimed(study), [100.0, 100, 100, 900, 900, 900, 900, 900, 1e9]) == (
        "pruned"
    )
    assert scripted(study, claimed(study), [2 * value for value in good]) == "complete"
    assert [result.train_seconds for result in study.results()] == [9, 1, 3, 9]
    assert [result.number for result in study.ranked()] == [3, 0]


def test_the_base_config_is_never_pruned(tmp_path):
    study = study_at(tmp_path)
    first = claimed(study)
    assert first.base
    assert scripted(study, claimed(study), [5.0] * 9) == "complete"
    assert scripted(study, first, [1.0] * 9) == "complete"


def measured(volume: float) -> dict[str, float]:
    return {**dict.fromkeys(get_args(Indicator), 0.0), "hypervolume": volume}


def test_a_trial_reports_other_episodes_than_it_is_chosen_by(tmp_path, monkeypatch):
    study = study_at(tmp_path)

    def evaluations(config: Config, stopped: Any) -> Iterator[Evaluation]:
        for seconds, reported, choosing in ((1.0, 9.0, 3.0), (2.0, 4.0, 5.0), (9.0, 6.0, 4.0)):
            indicators = measured(reported), measured(choosing)
            yield Evaluation(1, 10, seconds, 9.0, 1, 0, None, *indicators)

    monkeypatch.setattr(trial_module, "evaluations", evaluations)
    trial_module.run_trial(study, claimed(study), lambda: False)
    assert [result.indicators["hypervolume"] for result in study.results()] == [4.0]


def test_a_trial_is_the_best_only_with_other_seeds_too(tmp_path, monkeypatch):
    script = [[10.0, 11.0, 12.0], [20.0, 6.0, 1.0], [9.0], [12.0, 5.0], [12.0, 14.0, 13.0]]
    study = study_at(tmp_path)

    def evaluations(config: Config, stopped: Any) -> Iterator[Evaluation]:
        value = script[claim.trial.number][config.seed - tiny().seed]
        yield Evaluation(1, 10, 9.0, 9.0, 1, 0, None, measured(value))

    monkeypatch.setattr(trial_module, "evaluations", evaluations)
    monkeypatch.setattr(trial_module, "release_memory", lambda: None)  # nothing is held
    for _ in script:
        claim = claimed(study)
        trial_module.run_trial(study, claim, lambda: False)
    found = [(r.seeds, r.indicators["hypervolume"]) for r in study.results()]
    assert found == [(3, 11), (3, 9), (1, 9), (2, 8.5), (3, 13)]
    best = study.ranked()[0]
    assert (best.number, best.train_seconds, best.env_steps) == (4, 9, 10)
    write_results(study, tmp_path)
    text = (tmp_path / "best.yaml").read_text()
    assert "hypervolume 1.3000e+01" in text and "mean of 3 seeds" in text
    assert [row["seeds"] for row in rows(tmp_path)] == ["3", "3", "1", "2", "3"]


def test_several_indicators_keep_all_non_dominated_trials(tmp_path):
    study = study_at(tmp_path, "hypervolume", "expected_utility")
    for value in (1.0, 3.0, 2.0):
        assert scripted(study, claimed(study), [value]) == "complete"
    assert [result.indicators["hypervolume"] for result in study.ranked()] == [3, 2, 1]


def test_importance_finds_the_option_that_matters(tmp_path):
    study = study_at(tmp_path, **{"ppo.epochs": [2, 3], "ppo.learning_rate": [1e-4, 2e-4, 3e-4]})
    assert importances(study) == {}
    for _ in range(12):
        claim = claimed(study)
        scripted(study, claim, [claim.config.ppo.learning_rate] * 9)
    shares = importances(study)
    assert next(iter(shares)) == "ppo.learning_rate"


def test_trials_change_few_options_of_the_best_trial(tmp_path):
    study = study_at(tmp_path, **space_values(None, "cpu"))
    found = [claimed(study)]
    for value in (1.0, 2.0, *[0.5] * 10):
        scripted(study, found[-1], [value])
        found.append(claimed(study))
    options = [study._space.options(claim.trial.params) for claim in found]
    for earlier, later in ((0, 1), *((1, n) for n in range(2, len(found)))):
        changed = [name for name in options[0] if options[earlier][name] != options[later][name]]
        assert 1 <= len(changed) <= 9


def test_draws_fit_together(tmp_path):
    space = {"sampling.clusters": [4, 7, 8, 16], "ppo.minibatches": [2, 3, 5, 8]}
    study = study_at(tmp_path, **space)
    for _ in range(20):
        scripted(study, claimed(study), [1.0] * 9)
    assert len(study.results()) == 20


@pytest.mark.parametrize(
    ("env", "device_type"), [("ant", "cpu"), ("bruce", "cuda"), ("cheetah", "cuda")]
)
def test_the_default_space_fits_every_task(env, device_type, tmp_path):
    base, space = config_for(env, device="cpu"), space_values(None, device_type)
    study = study_at(tmp_path, base=base, **space)
    for _ in range(2):
        assert claimed(study).config.max_seconds == 9


BAD_SPACES = {
    "empty": ("{}", "the search space bad.yaml is empty"),
    "unknown option": ("ppo.learning_rat: [1]", "did you mean 'learning_rate'?"),
    "a section": ("ppo: {clip: [1]}", "ppo is a section: name its options, such as ppo.learning"),
    "a constant": ("ppo.clip: 0.2", "ppo.clip needs a list of values"),
    "low above high": ("ppo.clip: {low: 3, high: 1}", "low must not be above high"),
    "unknown key": ("ppo.clip: {low: 1, high: 3, stop: 1}", "did you mean 'step'?"),
    "log of zero": ("ppo.entropy: {low: 0, high: 1, log: true}", "which has no logarithm"),
    "log and step": ("ppo.clip: {low: 1, high: 2, log: true, step: 1}", "both log and step"),
    "step of zero": ("ppo.clip: {low: 1, high: 2, step: 0}", "has step 0: use one above 0"),
    "text in a range": ("ppo.clip: {low: a, high: 2}", "low 'a', which is not a number"),
    "endless": ("ppo.clip: {low: 0.1, high: .inf}", "high inf, which is not finite"),
    "log of what": ("ppo.clip: {low: 1, high: 2, log: 3}", "has log 3: use true or false"),
    "empty list": ("ppo.clip: []", "has an empty list"),
    "twice": ("ppo.clip: [0.1, 0.2, 0.1]", "lists 0.1 twice"),
    "fractions": ("ppo.epochs: {low: 1.0, high: 3.5}", "ppo.epochs: Input should be a valid int"),
    "out of bounds": ("ppo.discount: {low: 0.9, high: 1.1}", "less than or equal to 1"),
    "no multiples": ("task.stagger: {times: [1, 2]}", "is False in the base config, which has no"),
    "no factors": ("worlds: {times: [0, 1]}", "needs a list of positive factors"),
    "never fits": ("sampling.clusters: [7, 9]", "do not fit together, the last one because"),
    **{
        f"measures {name}": (f"{name}: [{value}]", f"names {name}, which all trials share")
        for name, value in {
            "env": "ant",
            "seed": "1",
            "evaluation.tradeoffs": "9",
            "task.objectives": "{}",
            "task.objectives.run.run": "3",
            "task.randomization.mass": "[0.5, 2]",
        }.items()
    },
}


@pytest.mark.parametrize("mistake", BAD_SPACES)
def test_a_bad_space_is_one_sentence(mistake, workplace, monkeypatch, capsys):
    text, sentence = BAD_SPACES[mistake]
    (workplace / "bad.yaml").write_text(text)
    assert sentence in refused(monkeypatch, capsys, "--space", "bad.yaml")
    assert not Path("tuning").exists()


BAD_OPTIONS = {
    "no time": (("--seconds", "0"), "seconds"),
    "own limit": (("--max-seconds", "5"), "sets max_seconds by --seconds: leave out --max-seconds"),
    "own times": (("--evaluation.every", "5"), "leave out --evaluation.every"),
    "indicator": (("--indicators", "hypervolum"), "hypervolum"),
    "indicator twice": (("--indicators", *["sparsity"] * 2), "each only once"),
    "no space": (("--space", "none.yaml"), "there is no space none.yaml"),
    "no database": (("--storage", "nosql://x"), "cannot use the storage nosql://x"),
    "damaged": (("--storage", "space.yaml"), "cannot use the storage space.yaml"),
    "a folder": (("--storage", "."), "it is not a regular file"),
    "no journal": (("--storage", "line.yaml"), "line.yaml: it is not a journal"),
}


@pytest.mark.parametrize("mistake", BAD_OPTIONS)
def test_a_bad_option_is_one_sentence(mistake, workplace, monkeypatch, capsys):
    options, sentence = BAD_OPTIONS[mistake]
    (workplace / "line.yaml").write_text("env: hopper")
    assert sentence in refused(monkeypatch, capsys, *options)
    assert (workplace / "line.yaml").read_text() == "env: hopper"


@contextmanager
def room(size: int) -> Iterator[None]:
    """Let files grow to at most `size` bytes, as on a disk that is then full."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


def test_a_study_goes_on_after_a_full_disk(tmp_path):
    study, journal = study_at(tmp_path), tmp_path / "journal.log"
    scripted(study, claimed(study), [1.0, 2.0])
    claim, size = claimed(study), journal.stat().st_size
    sentence = f"cannot write the journal {journal}: File too large."
    with room(size + 20), pytest.raises(MorlaxError) as full:
        study.finish(claim, {"hypervolume": 3.0}, 9.0, 1)
    assert str(full.value) == sentence
    assert journal.stat().st_size == size + 20  # half a line
    again = study_at(tmp_path)
    assert [result.indicators["hypervolume"] for result in again.results()] == [2.0]
    assert again.finish(claim, {"hypervolume": 3.0}, 9.0, 1).state == "complete"
    for line in journal.read_text().splitlines():
        json.loads(line)
    assert len(study_at(tmp_path).results()) == 2


def test_a_full_disk_ends_a_search_without_blaming_the_trial(tmp_path, monkeypatch):
    def train(study: Study, claim: Claim, stopped: object) -> None:
        with room((tmp_path / "journal.log").stat().st_size + 20):
            study.prunes(claim, 1.0, 1.0)

    monkeypatch.setattr(trial_module, "_train", train)
    study = study_at(tmp_path)
    with pytest.raises(MorlaxError, match=r"cannot write the journal .*journal\.log"):
        trial_module.run_trial(study, claimed(study), lambda: False)
    assert not study_at(tmp_path).results()


def test_a_full_disk_under_a_database_is_one_sentence(workplace, monkeypatch):
    def train(study: Study, claim: Claim, stopped: object) -> None:
        with room(Path("study.db").stat().st_size):
            for number in range(1000):
                claim.trial.set_user_attr(str(number), "x" * 1000)

    monkeypatch.setattr(trial_module, "_train", train)
    with pytest.raises(MorlaxError, match=r"cannot use the storage sqlite:///study.db: .+\."):
        search(tiny(), "space.yaml", trials=2, seconds=0.1, storage="sqlite:///study.db")


def test_a_study_keeps_what_its_trials_share(tmp_path):
    study_at(tmp_path)
    with pytest.raises(MorlaxError, match="was started with another --space"):
        study_at(tmp_path, **{"ppo.epochs": [2, 3]})
    with pytest.raises(MorlaxError, match="was started with another --seconds"):
        study_at(tmp_path, seconds=8.0)


def test_a_study_from_before_an_option_existed_goes_on(tmp_path):
    study = study_at(tmp_path)
    known = study._study.user_attrs["plan"]
    assert known["config"].pop("start_from") is None
    study._study.set_user_attr("plan", known)
    study_at(tmp_path)


@pytest.mark.parametrize(
    ("option", "value", "range"),
    [
        ("ppo.clip", 0.22, {"low": 0.1, "high": 0.4, "step": 0.05}),
        ("ppo.epochs", 4, {"low": 3, "high": 9, "step": 2}),
        ("ppo.entropy", 0.02, {"low": 0, "high": 1}),
    ],
)
def test_a_base_config_between_the_steps_of_a_range_is_trial_0(option, value, range, tmp_path):
    base = config_for("hopper", **{"device": "cpu", option: value})
    study = study_at(tmp_path, base=base, **{option: range})
    first, second = claimed(study), claimed(study)
    assert first.base and first.config == study.plan.base
    assert not second.base and second.config != study.plan.base


def test_trials_start_from_the_policies_that_the_config_names(tmp_path):
    start = train(tiny(max_env_steps=32 * 5 * 20), output=tmp_path / "start")
    latest = str(start.checkpoints / "latest.pt")
    config = tiny(start_from=latest, max_seconds=0.01, max_env_steps=None)
    with closing(trial_module.evaluations(config, lambda: False)) as found:
        returns = next(found).front.returns
    np.testing.assert_array_equal(returns, Front.load(start.checkpoints / "latest.npz").returns)


def test_a_missing_optuna_names_the_extra(workplace, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("morlax_torch.tuning.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "pip install 'morlax-torch[tune]'" in refused(monkeypatch, capsys)


def test_torchrun_is_refused(monkeypatch):
    monkeypatch.setattr(tune, "SEVERAL", True)
    with pytest.raises(MorlaxError, match="start it without torchrun"):
        tune.command(TINY)


def test_workers_are_spread_over_gpus(monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    gpu = torch.device("cuda", 0)
    assert places(gpu, None, False) == ["0", "1"]
    assert places(gpu, 4, False) == ["0", "1", "0", "1"]
    assert places(gpu, None, True) == [None]
    assert places(torch.device("cpu"), 3, False) == [None] * 3
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
    assert places(gpu, 3, False) == ["5", "7", "5"]
