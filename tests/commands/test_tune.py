"""Hyperparameter search: trials, their files, sharing, interruption, failures and bad spaces."""

import csv
import errno
import math
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("optuna", reason="needs the extra tune")

from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial

from morlax_torch import MorlaxError, config_for
from morlax_torch.commands import train as train_command
from morlax_torch.commands import tune
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.files import space_values
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run
from morlax_torch.runs.progress import Evaluation, Progress
from morlax_torch.train import train
from morlax_torch.tuning import study as study_module
from morlax_torch.tuning.study import Search, changed

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
    return tune.read(TINY)[0].model_copy(update=changes)


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


def search_at(path: Path, base: Config | None = None, seconds: float = 9.0, **space: Any) -> Search:
    return Search(base or tiny(), space or VALUES, path, seconds)


Reached = tuple[float, float, float]  # seconds, hypervolume, and the one that is chosen by
Training = Callable[[Config], Sequence[Reached]]


@pytest.fixture
def trained(monkeypatch) -> Callable[[Training], None]:
    """Return a function that replaces training by what another function says of a config."""

    def replace(training: Training) -> None:
        def yielded(config: Config) -> Iterator[Evaluation]:
            progress = Progress()
            for seconds, value, choosing in training(config):
                reached = {"hypervolume": value}, {"hypervolume": choosing}
                best = progress.improved(choosing, value)
                yield Evaluation(1, 10, seconds, 9.0, 1, 0, None, *reached, best)

        def session(config: Config, written: bool) -> SimpleNamespace:
            return SimpleNamespace(training=lambda stopped, evaluate_at: yielded(config))

        monkeypatch.setattr(study_module, "Session", SimpleNamespace(of=session))
        monkeypatch.setattr(study_module, "release_memory", lambda: None)  # nothing is held

    return replace


@pytest.fixture
def scripted(trained, monkeypatch) -> Callable[..., list[FrozenTrial]]:
    """Return a function that runs a training per curve, which it reaches at even times."""

    def run(search: Search, *curves: Any, seeds: int = 1, trials: int = 0) -> list[FrozenTrial]:
        left = iter(curves)

        def training(config: Config) -> Sequence[Reached]:
            curve = next(left)
            if isinstance(curve, BaseException):
                raise curve
            curve = curve(config) if callable(curve) else curve
            step = search.seconds / len(curve)
            return [(step * number, value, value) for number, value in enumerate(curve, 1)]

        trained(training)
        monkeypatch.setattr(study_module, "SEEDS", seeds)
        done: list[FrozenTrial] = []
        number = len(search.finished()) + (trials or len(curves))
        search.run(number, bool, lambda study, trial: done.append(trial))
        return done

    return run


def states(search: Search) -> list[str]:
    return [trial.state.name.lower() for trial in search.finished()]


@pytest.mark.slow
def test_a_search_writes_trials_and_a_config_that_trains(workplace, monkeypatch, capsys):
    run(monkeypatch, "--trials", "3")
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if not line.startswith("next: ")) <= 80
    assert "3 of 3 trials done; the best:" in lines
    table = rows()
    assert table[0]["ppo.learning_rate"] == "0.0005" and table[0]["seeds"] == "3"
    assert all(float(row["hypervolume"]) > 0 for row in table)
    complete = [row for row in table if row["state"] == "complete"]
    best = max(complete, key=lambda row: float(row["hypervolume"]))
    words = "--config tuning/hopper/best.yaml --device cpu --max-seconds 0.1 --output run"
    train_command.command(words.split())
    config = Run.open(Path("run")).config()
    assert config.ppo.learning_rate == float(best["ppo.learning_rate"])
    assert (config.worlds, config.task.episode_length) == (32, 20)
    assert config.max_env_steps is None

    run(monkeypatch, "--trials", "3")
    assert "3 of them done" in capsys.readouterr().out
    assert rows() == table


def test_searches_share_the_trials_of_one_folder(tmp_path, scripted):
    for curves in ([[1.0], [2.0]], [[3.0], [4.0]]):
        search = search_at(tmp_path)
        scripted(search, *curves)
    trials = search.finished()
    assert [trial.params == search.base_draw for trial in trials] == [True, False, False, False]
    assert len({tuple(trial.params.values()) for trial in trials}) == 4
    assert [float(row["hypervolume"]) for row in rows(tmp_path)] == [1, 2, 3, 4]


@pytest.mark.slow
def test_processes_share_a_study_and_a_signal_ends_each(workplace):
    command, pipe = typed("--trials", "500"), subprocess.PIPE
    processes = [subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) for _ in "12"]
    table = Path("tuning/hopper/trials.csv")
    while not table.exists() or len(table.read_text()) < 500:
        assert all(process.poll() is None for process in processes)
        time.sleep(0.1)
    for process in processes:
        process.send_signal(signal.SIGINT)
    for process in processes:
        told, errors = process.communicate(timeout=100)
        assert process.returncode == 130 and not errors, errors
        assert told.count("continue: python -m morlax_torch tune --env hopper") == 1
        assert told.count("of 500 trials done; the best:") == 1
        assert "the base config" in told.split("the best:")[1] or "learning_rate=" in told
    assert Path("tuning/hopper/best.yaml").exists()
    drawn = [(row["ppo.learning_rate"], row["ppo.epochs"]) for row in rows()]
    assert len(set(drawn)) == len(drawn)


def test_an_interrupted_trial_is_run_again(workplace, scripted):
    asked: list[int] = []

    def stopped() -> bool:
        asked.append(1)
        return len(asked) > 3

    search = search_at(workplace, seconds=100.0)
    search.run(3, stopped)
    assert search.finished() == []
    (first,) = scripted(search, [1.0])
    assert first.params == search.base_draw and first.number == 1


def test_a_trial_that_fails_does_not_end_the_study(tmp_path, scripted):
    search = search_at(tmp_path)
    scripted(search, MorlaxError("the loss became nan."), MemoryError(), [1.0])
    failures = [(row["state"], row["reason"]) for row in rows(tmp_path)]
    assert failures[0] == ("pruned", "the loss became nan.")
    assert failures[1][0] == "pruned" and failures[1][1].startswith("the memory is full")
    assert failures[2] == ("complete", "")


def test_options_that_do_not_fit_together_are_a_reason(tmp_path, scripted):
    search = search_at(tmp_path, **{"sampling.clusters": [7]})
    scripted(search, [1.0], trials=2)
    assert states(search) == ["complete", "pruned"]
    assert "clusters" in rows(tmp_path)[1]["reason"]


def test_clearly_worse_trials_are_pruned_at_a_ninth_and_a_third_of_the_time(tmp_path, scripted):
    search, good = search_at(tmp_path), [100.0 * n for n in range(1, 10)]
    late = [100.0, 100, 100, 900, 900, 900, 900, 900, 1e9]
    trials = scripted(search, good, [1.0] * 9, late, [2 * value for value in good])
    assert states(search) == ["complete", "pruned", "pruned", "complete"]
    assert [trial.last_step for trial in trials] == [8, 1, 3, 8]
    assert [trial.number for trial in search.ranked()] == [trials[3].number, 0]


def test_the_base_config_is_never_pruned(tmp_path, scripted):
    search = search_at(tmp_path)
    scripted(search, [5.0] * 9)
    search.study.enqueue_trial(search.base_draw)
    scripted(search, [1.0] * 9)
    assert states(search) == ["complete", "complete"]


def test_a_trial_reports_other_episodes_than_it_is_chosen_by(tmp_path, trained):
    search = search_at(tmp_path)
    trained(lambda config: [(1.0, 9.0, 3.0), (2.0, 4.0, 5.0), (9.0, 6.0, 4.0)])
    search.run(1)
    assert [trial.value for trial in search.finished()] == [4.0]


def test_a_trial_is_the_best_only_with_other_seeds_too(tmp_path, scripted):
    script = [[10.0, 11.0, 12.0], [20.0, 6.0, 1.0], [9.0], [12.0, 5.0], [12.0, 14.0, 13.0]]
    search, seed = search_at(tmp_path), tiny().seed
    curves = [
        lambda config, values=values, number=number: [
            values[number] if config.seed == seed + number else math.nan
        ]
        for values in script
        for number in range(len(values))
    ]
    trials = scripted(search, *curves, seeds=3, trials=5)
    found = [(trial.user_attrs["seeds"], trial.value) for trial in trials]
    assert found == [(3, 11), (3, 9), (1, 9), (2, 8.5), (3, 13)]
    assert search.ranked()[0].number == trials[4].number
    assert "Trial 4 of 5: hypervolume 1.3000e+01" in (tmp_path / "best.yaml").read_text()
    assert [row["seeds"] for row in rows(tmp_path)] == ["3", "3", "1", "2", "3"]


def test_trials_change_few_options_of_the_best_trial(tmp_path, scripted):
    random.seed(0)
    search = search_at(tmp_path, **space_values(None, "cpu"))
    base, best, *later = (x.params for x in scripted(search, [1.0], [2.0], *[[0.5]] * 10))

    def differing(trial: dict[str, Any], other: dict[str, Any]) -> int:
        return sum(trial[name] != other[name] for name in search.space)

    changes = [differing(trial, best) for trial in later]
    assert 1 <= differing(best, base) <= 9 and 1 <= min(changes) <= max(changes) <= 9
    assert sum(changes) < sum(differing(trial, base) for trial in later)


@pytest.mark.parametrize(
    ("env", "device_type"), [("ant", "cpu"), ("bruce", "cuda"), ("cheetah", "cuda")]
)
def test_the_default_space_fits_every_task(env, device_type, tmp_path, scripted):
    base, space = config_for(env, device="cpu"), space_values(None, device_type)
    search = search_at(tmp_path, base, **space)
    first, second = (changed(search.base, x.params) for x in scripted(search, [1.0], [1.0]))
    assert first == search.base != second and second.max_seconds == 9


def test_the_value_of_the_base_config_belongs_to_the_space(tmp_path, scripted):
    space = {
        "ppo.clip": {"low": 0.3, "high": 0.4},
        "network.actor": [[128, 128]],
        "ppo.epochs": [9],
    }
    search = search_at(tmp_path, **space)
    assert search.space["ppo.clip"].low == search.base.ppo.clip < 0.3
    assert [changed(search.base, t.params) for t in scripted(search, [1.0])] == [search.base]


BAD_SPACES = {
    "empty": ("{}", "the search space is empty"),
    "unknown option": ("ppo.learning_rat: [1]", "did you mean 'learning_rate'?"),
    "low above high": ("ppo.clip: {low: 3, high: 1}", "`low <= high` must hold"),
    "log of zero": ("ppo.entropy: {low: 0.0, high: 1, log: true}", "`low > 0` must hold"),
    "out of bounds": ("ppo.discount: {low: 0.9, high: 1.1}", "less than or equal to 1"),
    "a number": ("3: [1]", "the search space: 3: "),
    "no multiples": ("ppo.desired_kl: {times: [2]}", "ppo.desired_kl: "),
    "neither list nor range": ("ppo.epochs: 3", "use a list of values"),
    "range of an option that is off": ("ppo.desired_kl: {low: 0.01, high: 1}", "use a list"),
    **{
        f"measures {name}": (f"{name}: [{value}]", f"{name}: all trials share it")
        for name, value in {
            "env": "ant",
            "task.objectives.run.run": "3",
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
    "own limit": (("--max-seconds", "5"), "itself: use --seconds instead"),
    "no space": (("--space", "none.yaml"), "there is no space none.yaml"),
    "a file": (("--output", "space.yaml"), "cannot make space.yaml"),
}


@pytest.mark.parametrize("mistake", BAD_OPTIONS)
def test_a_bad_option_is_one_sentence(mistake, workplace, monkeypatch, capsys):
    options, sentence = BAD_OPTIONS[mistake]
    assert sentence in refused(monkeypatch, capsys, *options)


@pytest.mark.parametrize("damage", ["env: hopper", "env: hopper\n", '{"op_code":4,"worker', None])
def test_a_journal_that_cannot_be_used_is_one_sentence(damage, tmp_path, scripted):
    scripted(search_at(tmp_path), [1.0, 2.0])
    journal = tmp_path / "journal.log"
    whole = journal.read_text()
    if damage is None:
        journal.unlink()
        journal.mkdir()
    else:
        journal.write_text(whole + damage)
    with pytest.raises(MorlaxError, match=str(journal)) as refusal:
        search_at(tmp_path)
    assert "\n" not in str(refusal.value)
    if damage is not None:
        assert journal.read_text() == whole + damage
        journal.write_text(whole)  # without the damaged line
        assert [trial.value for trial in search_at(tmp_path).finished()] == [2.0]


@pytest.mark.parametrize("written", [0, 3])
def test_a_full_disk_is_one_sentence(written, tmp_path, scripted, monkeypatch):
    search, usual, calls = search_at(tmp_path), JournalFileBackend.append_logs, []

    def append(self: JournalFileBackend, logs: list) -> None:
        calls.append(logs)
        if len(calls) > written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        usual(self, logs)

    monkeypatch.setattr(JournalFileBackend, "append_logs", append)
    with pytest.raises(MorlaxError, match=f"cannot write to {tmp_path}: No space left on device"):
        scripted(search, [1.0, 2.0], [1.0, 2.0])


def test_a_study_keeps_what_its_trials_share(tmp_path):
    search = search_at(tmp_path)
    others = {"space": {"ppo.epochs": [2, 3]}, "seconds": {"seconds": 8.0}}
    others["env"] = {"base": config_for("ant", device="cpu")}
    for option, changes in others.items():
        with pytest.raises(MorlaxError, match=f"has another --{option}:"):
            search_at(tmp_path, **changes)
    plan = search.study.user_attrs["plan"]
    assert plan.pop("start_from") is None  # a study from before an option existed goes on
    search.study.set_user_attr("plan", plan)
    search_at(tmp_path)


def test_trials_start_from_the_policies_that_the_config_names(tmp_path, monkeypatch):
    start = train(tiny(max_env_steps=32 * 5 * 20), output=tmp_path / "start")
    latest = str(start.checkpoints / "latest.pt")
    fronts: list[Front] = []

    class Watched(study_module.Session):
        def training(self, **settings: Any) -> Iterator[Evaluation]:
            for evaluation in super().training(**settings):
                fronts.append(evaluation.front)
                yield evaluation

    monkeypatch.setattr(study_module, "Session", Watched)
    search_at(tmp_path / "search", tiny(start_from=latest), seconds=0.01).run(1)
    expected = Front.load(start.checkpoints / "latest.npz").returns
    np.testing.assert_array_equal(fronts[0].returns, expected)


def test_a_missing_optuna_names_the_extra(workplace, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("morlax_torch.tuning.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "pip install 'morlax-torch[tune]'" in refused(monkeypatch, capsys)
