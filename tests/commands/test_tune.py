"""Hyperparameter search: trials, their files, sharing, interruption, failures and bad spaces."""

import csv
import json
import math
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml

pytest.importorskip("optuna", reason="needs the extra tune")

from morlax_torch import MorlaxError, config_for
from morlax_torch.commands import train as train_command
from morlax_torch.commands import tune
from morlax_torch.commands.terminal import cli
from morlax_torch.configuration.config import Config
from morlax_torch.configuration.files import space_values
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run
from morlax_torch.runs.progress import Evaluation
from morlax_torch.train import train
from morlax_torch.tuning import study as study_module
from morlax_torch.tuning.study import Indicator, Search, Trial, state_of

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


def search_at(
    path: Path, *indicators: Any, base: Config | None = None, seconds: float = 9.0, **space: Any
) -> Search:
    chosen = indicators or ("hypervolume",)
    return Search(base or tiny(), space or VALUES, path, seconds=seconds, indicators=chosen)


def measured(volume: float) -> dict[str, float]:
    return {**dict.fromkeys(get_args(Indicator), 0.0), "hypervolume": volume}


@pytest.fixture
def scripted(monkeypatch) -> Callable[..., list[Trial]]:
    """Return a function that runs a training per curve, which it reaches at even times."""

    def run(search: Search, *curves: Any, seeds: int = 1, trials: int = 0) -> list[Trial]:
        left = iter(curves)

        def evaluations(config: Config, stopped: Any) -> Iterator[Evaluation]:
            curve = next(left)
            if isinstance(curve, BaseException):
                raise curve
            curve = curve(config) if callable(curve) else curve
            for number, value in enumerate(curve, 1):
                seconds = search.seconds * number / len(curve)
                reached = {**measured(value), "expected_utility": -value}
                yield Evaluation(number, number, seconds, 9.0, 1, 0, None, reached)

        monkeypatch.setattr(study_module, "evaluations", evaluations)
        monkeypatch.setattr(study_module, "SEEDS", seeds)
        monkeypatch.setattr(study_module, "release_memory", lambda: None)  # nothing is held
        done: list[Trial] = []
        search.run(len(search.finished()) + (trials or len(curves)), on_trial=done.append)
        return done

    return run


def states(search: Search) -> list[str]:
    return [state_of(trial) for trial in search.finished()]


@pytest.mark.slow
def test_a_search_writes_trials_and_a_config_that_trains(workplace, monkeypatch, capsys):
    run(monkeypatch, "--trials", "3")
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if not line.startswith("next: ")) <= 80
    assert "3 of 3 trials done; the best:" in lines
    table = rows()
    assert table[0]["base"] == "True" and table[0]["ppo.learning_rate"] == "0.0005"
    assert all(float(row["hypervolume"]) > 0 and int(row["env_steps"]) > 0 for row in table)
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


def test_searches_share_the_trials_of_one_storage(tmp_path, scripted):
    base, storage = tiny(), str(tmp_path / "shared.log")
    for folder, curves in (("one", [[1.0], [2.0]]), ("other", [[3.0], [4.0]])):
        search = Search(base, VALUES, tmp_path / folder, seconds=9.0, storage=storage)
        scripted(search, *curves)
    trials = search.finished()
    assert [trial.user_attrs.get("base", False) for trial in trials] == [True, False, False, False]
    assert len({tuple(trial.user_attrs["options"].values()) for trial in trials}) == 4
    assert len(rows(tmp_path / "one")) == 2 and len(rows(tmp_path / "other")) == 4


@pytest.mark.slow
def test_workers_share_a_study_and_a_signal_ends_all_of_them(workplace):
    command = typed("--trials", "500", "--workers", "2")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    table = Path("tuning/hopper/trials.csv")
    while process.poll() is None and (not table.exists() or len(table.read_text()) < 500):
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=100)[0]
    assert process.returncode == 130, told
    assert "Traceback" not in told and told.count("starting") == 0
    assert told.count("continue: python -m morlax_torch tune --env hopper") == 1
    assert "the base config" in told
    assert told.count("of 500 trials done") == 1 and Path("tuning/hopper/best.yaml").exists()
    drawn = [(row["ppo.learning_rate"], row["ppo.epochs"]) for row in rows()]
    assert len(set(drawn)) == len(drawn)
    assert [row["base"] for row in rows()].count("True") == 1


def test_an_interrupted_trial_is_run_again(workplace, scripted):
    asked: list[int] = []

    def stopped() -> bool:
        asked.append(1)
        return len(asked) > 3

    search = Search(tiny(), VALUES, seconds=100.0)
    search.run(3, stopped)
    assert search.finished() == []
    (first,) = scripted(search, [1.0])
    assert first.user_attrs["base"] and first.number == 1


@pytest.mark.parametrize("storage", [None, "sqlite:///study.db"])
def test_a_trial_that_fails_does_not_end_the_study(workplace, scripted, storage):
    search = Search(tiny(), VALUES, "results", seconds=9.0, storage=storage)
    scripted(search, MorlaxError("the loss became nan."), MemoryError(), [1.0])
    failures = [(row["state"], row["reason"]) for row in rows(Path("results"))]
    assert failures[0] == ("fail", "the loss became nan.")
    assert failures[1][1].startswith("the memory is full")
    assert failures[2] == ("complete", "")


def test_clearly_worse_trials_are_pruned_at_a_ninth_and_a_third_of_the_time(tmp_path, scripted):
    search, good = search_at(tmp_path), [100.0 * n for n in range(1, 10)]
    late = [100.0, 100, 100, 900, 900, 900, 900, 900, 1e9]
    trials = scripted(search, good, [1.0] * 9, late, [2 * value for value in good])
    assert states(search) == ["complete", "pruned", "pruned", "complete"]
    assert [t.user_attrs["measured"]["train_seconds"] for t in trials] == [9, 1, 3, 9]
    assert [trial.number for trial in search.ranked()] == [trials[3].number, 0]


def test_the_base_config_is_never_pruned(tmp_path, scripted):
    search = search_at(tmp_path)
    base = search.study.ask()
    scripted(search, [5.0] * 9, trials=1)
    search.study.enqueue_trial(base.params, {"base": True})
    (again,) = scripted(search, [1.0] * 9)
    assert again.user_attrs["base"] and states(search) == ["complete", "complete"]


def test_a_trial_reports_other_episodes_than_it_is_chosen_by(tmp_path, monkeypatch):
    search = search_at(tmp_path)

    def evaluations(config: Config, stopped: Any) -> Iterator[Evaluation]:
        for seconds, reported, choosing in ((1.0, 9.0, 3.0), (2.0, 4.0, 5.0), (9.0, 6.0, 4.0)):
            indicators = measured(reported), measured(choosing)
            yield Evaluation(1, 10, seconds, 9.0, 1, 0, None, *indicators)

    monkeypatch.setattr(study_module, "evaluations", evaluations)
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
    found = [(t.user_attrs["measured"]["seeds"], t.value) for t in trials]
    assert found == [(3, 11), (3, 9), (1, 9), (2, 8.5), (3, 13)]
    assert search.ranked()[0].number == trials[4].number
    text = (tmp_path / "best.yaml").read_text()
    assert "hypervolume 1.3000e+01" in text and "mean of 3 seeds" in text
    assert [row["seeds"] for row in rows(tmp_path)] == ["3", "3", "1", "2", "3"]


def test_several_indicators_keep_all_non_dominated_trials(tmp_path, scripted):
    search = search_at(tmp_path, "hypervolume", "expected_utility")
    scripted(search, [1.0], [3.0], [2.0])
    assert [trial.values[0] for trial in search.ranked()] == [3, 2, 1]


def test_trials_change_few_options_of_the_best_trial(tmp_path, scripted):
    search = search_at(tmp_path, **space_values(None, "cpu"))
    trials = scripted(search, [1.0], [2.0], *[[0.5]] * 10)
    options = [trial.user_attrs["options"] for trial in trials]
    for earlier, later in ((0, 1), *((1, number) for number in range(2, len(trials)))):
        changed = [name for name in options[0] if options[earlier][name] != options[later][name]]
        assert 1 <= len(changed) <= 9


@pytest.mark.parametrize(
    ("env", "device_type"), [("ant", "cpu"), ("bruce", "cuda"), ("cheetah", "cuda")]
)
def test_the_default_space_fits_every_task(env, device_type, tmp_path, scripted):
    base, space = config_for(env, device="cpu"), space_values(None, device_type)
    search = search_at(tmp_path, base=base, **space)
    assert [search.config(t).max_seconds for t in scripted(search, [1.0], [1.0])] == [9, 9]


BAD_SPACES = {
    "empty": ("{}", "the space bad.yaml is empty"),
    "unknown option": ("ppo.learning_rat: [1]", "did you mean 'learning_rate'?"),
    "low above high": ("ppo.clip: {low: 3, high: 1}", "`low <= high` must hold"),
    "log of zero": ("ppo.entropy: {low: 0.0, high: 1, log: true}", "`low > 0` must hold"),
    "out of bounds": ("ppo.discount: {low: 0.9, high: 1.1}", "less than or equal to 1"),
    "never fits": (
        "sampling.clusters: [7, 9]",
        "draws from the space bad.yaml do not fit",
    ),
    **{
        f"measures {name}": (f"{name}: [{value}]", f"{name}: all trials share it")
        for name, value in {
            "env": "ant",
            "task.objectives.run.run": "3",
        }.items()
    },
}


@pytest.mark.parametrize("mistake", BAD_SPACES)
def test_a_bad_space_is_one_sentence(mistake, workplace, monkeypatch):
    text, sentence = BAD_SPACES[mistake]
    (workplace / "bad.yaml").write_text(text)
    with pytest.raises(MorlaxError) as refusal:
        Search(tiny(), "bad.yaml")
    assert sentence in str(refusal.value) and "\n" not in str(refusal.value)
    assert not Path("tuning").exists()


BAD_OPTIONS = {
    "no time": (("--seconds", "0"), "seconds"),
    "own limit": (("--max-seconds", "5"), "itself: use --seconds instead"),
    "indicator twice": (("--indicators", *["sparsity"] * 2), "name each indicator once"),
    "no space": (("--space", "none.yaml"), "there is no space none.yaml"),
    "a folder": (("--storage", "."), "it is not a journal"),
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


def test_a_study_goes_on_after_a_full_disk(tmp_path, scripted):
    search, journal = search_at(tmp_path), tmp_path / "journal.log"
    scripted(search, [1.0, 2.0])
    size = journal.stat().st_size

    with ExitStack() as stack:

        def fill(config: Config) -> list[float]:
            stack.enter_context(room(journal.stat().st_size + 20))
            return [3.0, 3.0]

        with pytest.raises(MorlaxError, match=f"cannot use the storage {journal}: File too large"):
            scripted(search, fill)
    assert journal.stat().st_size > size and not journal.read_bytes().endswith(b"\n")
    again = search_at(tmp_path)
    assert [trial.value for trial in again.finished()] == [2.0]
    scripted(again, [3.0])
    for line in journal.read_text().splitlines():
        json.loads(line)
    assert len(search_at(tmp_path).finished()) == 2


def test_a_study_keeps_what_its_trials_share(tmp_path):
    search = search_at(tmp_path)
    for changes, option in (({"ppo.epochs": [2, 3]}, "space"), ({"seconds": 8.0}, "seconds")):
        with pytest.raises(MorlaxError, match=f"was started with another --{option}"):
            search_at(tmp_path, **changes)
    plan = search.study.user_attrs["plan"]
    assert plan.pop("start_from") is None  # a study from before an option existed goes on
    search.study.set_user_attr("plan", plan)
    search_at(tmp_path)


def test_trials_start_from_the_policies_that_the_config_names(tmp_path):
    start = train(tiny(max_env_steps=32 * 5 * 20), output=tmp_path / "start")
    latest = str(start.checkpoints / "latest.pt")
    config = tiny(start_from=latest, max_seconds=0.01, max_env_steps=None)
    with closing(study_module.evaluations(config, lambda: False)) as found:
        returns = next(found).front.returns
    np.testing.assert_array_equal(returns, Front.load(start.checkpoints / "latest.npz").returns)


def test_a_missing_optuna_names_the_extra(workplace, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("morlax_torch.tuning.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "pip install 'morlax-torch[tune]'" in refused(monkeypatch, capsys)


def test_workers_are_spread_over_gpus(monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert tune.visible_gpus("cuda:0", None, False) == ["0", "1"]
    assert tune.visible_gpus("cuda:0", 4, False) == ["0", "1", "0", "1"]
    assert tune.visible_gpus("cuda:1", None, True) == [None]
    assert tune.visible_gpus("cpu", 3, False) == [None] * 3
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
    assert tune.visible_gpus("cuda:0", 3, False) == ["5", "7", "5"]
