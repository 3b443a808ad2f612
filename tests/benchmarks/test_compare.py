"""Benchmarks: statistics, resumption, shares, crashes, tables and figures; not their speed."""

import csv
import math
import subprocess
import sys
from collections import Counter
from importlib import import_module
from pathlib import Path

import compare
import compare_jobs
import compare_report
import compare_rows
import compare_statistics
import matched_widths
import numpy as np
import pytest
import search_methods
import throughput
import yaml
from same import csv_rows
from tiny import tiny

from morlax_torch import MorlaxError, load, pareto
from morlax_torch.configuration.config import Config
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.loading import evaluate
from morlax_torch.runs.progress import Evaluation
from morlax_torch.train import train

SCRIPT = Path(compare.__file__)
TRADEOFFS = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
SPHERE = np.array([[4.0, 1.0], [3.0, 3.0], [1.0, 4.0]])  # hypervolume 11 over the origin


def test_a_band_has_the_quartiles_of_all_runs_at_all_evaluations():
    curves = [([0, 2], [0, 8]), ([0, 1], [4, 4]), ([0, 3], [2, 1]), ([], [])]
    grid, quartiles = compare_statistics.band(curves)
    np.testing.assert_array_equal(grid, [0, 1, 2, 3])
    columns = [np.quantile(v, (0.25, 0.5, 0.75)) for v in ([0, 4, 2, 0], [8, 4, 2, 0])]
    np.testing.assert_allclose(quartiles.T, [columns[0], columns[0], columns[1], columns[1]])


@pytest.mark.parametrize("n", (1, 3, 4, 7, 13))
def test_the_interquartile_mean_cuts_a_quarter_at_each_end(n):
    scores = np.random.default_rng(n).normal(size=(3, n))
    for row, mean in zip(scores, compare_statistics.interquartile_mean(scores), strict=True):
        left = sorted(row)
        for _ in range(int(0.25 * n)):
            left = left[1:-1]
        assert mean == pytest.approx(sum(left) / len(left))


def test_a_bootstrap_draws_runs_of_each_task_with_replacement():
    tasks = [np.arange(5.0), 10 + np.arange(8.0) ** 2]
    drawn = compare_statistics.resampled(tasks, resamples=20_000)
    assert drawn.shape == (20_000, 13)
    for scores, part in zip(tasks, np.split(drawn, [5], axis=1), strict=True):
        assert set(part.flat) == set(scores)
        assert min(len(set(row)) for row in part) < len(scores)
        error = scores.std() / len(scores) ** 0.5  # of a mean of independent draws
        assert part.mean(1).std() == pytest.approx(error, rel=0.03)
        low, high = compare_statistics.interval(part.mean(1))
        assert (low + high) / 2 == pytest.approx(scores.mean(), abs=error / 4)
        assert high - low == pytest.approx(2 * 1.96 * error, rel=0.1)


def test_the_episodes_that_count_are_not_those_of_training(tmp_path):
    config = tiny(**{"task.reset_noise": 0.1, "seed": 3})
    folder = train(config, output=tmp_path / "run").folder
    fresh = compare.fresh_front(folder, "cpu")
    policy = load(folder)
    for seed in (0, config.seed):
        seen = evaluate(policy, device="cpu", seed=seed)
        np.testing.assert_array_equal(seen.tradeoffs, fresh.tradeoffs)
        assert (abs(seen.returns - fresh.returns) > 1e-3).all()


def test_igd_plus_is_scaled_by_the_range_of_the_reference():
    random = np.random.default_rng(0)
    points, reference = random.uniform(0, 1, (6, 3)), random.uniform(0, 1, (5, 3))
    spans = [max(z[k] for z in reference) - min(z[k] for z in reference) for k in range(3)]
    total = 0.0
    for z in reference:
        short = [[max(z[k] - a[k], 0) / spans[k] for k in range(3)] for a in points]
        total += min(math.hypot(*row) for row in short)
    factors = np.array([1e-3, 1.0, 1e5])
    for scale in (1.0, factors):
        found = compare_statistics.scaled_igd_plus(points * scale, reference * scale)
        assert found == pytest.approx(total / len(reference))
    assert compare_statistics.scaled_igd_plus(reference + 0.1, reference) == 0


def written(folder: Path, methods: object) -> Path:
    path = folder / "methods.yaml"
    path.write_text(yaml.safe_dump(methods, sort_keys=False))
    return path


@pytest.mark.parametrize("file", [compare.METHODS, SCRIPT.with_name("compare_ablations.yaml")])
def test_the_methods_that_come_with_the_benchmark_fit_its_tasks(file):
    methods = compare_jobs.read_methods(file, 60.0)
    assert methods[0] == compare_jobs.Method("MORLAX", {}, 60.0, False)
    jobs = compare_jobs.plan(("cheetah", "hopper", "walker", "ant", "humanoid"), methods, [3])
    for job in jobs:
        config = job.config("cpu")
        assert (config.seed, config.max_seconds) == (3, 300.0 if job.method.reference else 60.0)
        assert config.max_env_steps is None


def test_amor_has_as_many_parameters_as_morlax():
    methods = {method.name: method for method in compare_jobs.read_methods(compare.METHODS, 60.0)}
    changes = methods["AMOR, as many parameters"].of_tasks
    assert set(changes) == {"cheetah", "hopper", "walker", "ant", "humanoid"}
    for task, change in changes.items():
        wanted = matched_widths.parameters(task, "morlax")
        network = {name.removeprefix("network."): layers for name, layers in change.items()}
        found = matched_widths.parameters(task, "amor", network)
        for part in ("actor", "critic"):
            assert found[part] == pytest.approx(wanted[part], rel=2e-3)
        widths = matched_widths.matched(task, wanted)
        assert network == {part: [width, width] for part, width in widths.items()}


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ({"a": {"reference": True}, "b": {"reference": True}}, "a and b are the reference"),
        ({"a/b": {}}, "cannot name a folder"),
        ({"a": {"tasks": {"ant": {"seed": 3}}}}, "cannot change seed"),
    ],
)
def test_a_method_that_is_not_valid_is_refused(tmp_path, methods, message):
    with pytest.raises(MorlaxError, match=message):
        compare_jobs.read_methods(written(tmp_path, methods), 1.0)


class Trainer:
    """Stands in for `train`: writes evaluations of given returns, and counts its runs.

    A run's returns are SPHERE times the config's clip range, halved in the first and the last of
    three evaluations, and shifted by the seed. Its best checkpoint returns `share` of the best.
    """

    def __init__(self) -> None:
        self.seeds: list[int] = []
        self.share = 1.0
        self.fronts: dict[Path, Front] = {}
        self.crashes: dict[int, int] = {}  # seed -> evaluations before the crash

    def fresh_front(self, folder: Path, _: str) -> Front:
        return self.fronts[folder]

    def __call__(self, config: Config, output: Path) -> None:
        self.seeds.append(config.seed)
        most = self.crashes.get(config.seed, 3)
        if most:
            (output / "checkpoints").mkdir(parents=True)
            (output / "checkpoints" / "best.pt").touch()
        rows = []
        for k, share in enumerate((0.5, 1.0, 0.5)[:most]):
            returns = config.ppo.clip * share * SPHERE + config.seed
            nothing = np.zeros(3)
            front = Front(("a", "b"), TRADEOFFS, returns, nothing + 9, np.zeros(2), nothing)
            evaluation = Evaluation(k, 100 * k, 2.0 * k, 3.0 * k, 50, 0, front, front.indicators())
            rows.append(evaluation.row())
            with (output / "metrics.csv").open("w", newline="") as file:
                table = csv.DictWriter(file, rows[0])
                table.writeheader()
                table.writerows(rows)
            if share == 0.5 and k:
                continue
            self.fronts[output] = front._replace(returns=self.share * front.returns)
        if config.seed in self.crashes:
            raise MorlaxError("a loss is not finite,\nat 'this' place")


@pytest.fixture
def trainer(monkeypatch) -> Trainer:
    stand_in = Trainer()
    monkeypatch.setattr(import_module("morlax_torch.train"), "train", stand_in)
    monkeypatch.setattr(compare, "fresh_front", stand_in.fresh_front)
    return stand_in


@pytest.fixture
def start(tmp_path, trainer, monkeypatch):
    """Return a function that runs the command, with two methods and two seeds by default.

    Files of figures stay empty, because rendering takes most of the time.
    """
    monkeypatch.setattr(compare_report, "save", lambda _, stem, __: Path(f"{stem}.png").touch())
    methods = {"one": {"ppo.clip": 1.0}, "two": {"ppo.clip": 2.0}}

    def run(methods: dict = methods, tasks=("hopper",), seeds=(0, 1), share: str = "0/1") -> Path:
        output, file = tmp_path / "out", written(tmp_path, methods)
        compare.main(output, tasks, file, seeds, seconds=4.0, share=share, device="cpu")
        return output

    return run


def test_there_is_a_row_for_each_evaluation(start, trainer):
    trainer.share = 0.5  # what counts is the fresh evaluation of the chosen checkpoint
    rows = csv_rows(start() / "rows.csv")
    assert tuple(rows[0]) == compare_rows.COLUMNS
    keys = [(row["method"], row["seed"], row["env_steps"]) for row in rows]
    steps = ("0", "100", "200", "")  # the last row is that of the chosen checkpoint
    assert keys == [(m, s, e) for m in ("one", "two") for s in "01" for e in steps]
    assert [row["fresh"] for row in rows] == ["0", "0", "0", "1"] * 4
    volumes = [float(row["hypervolume"]) for row in rows[8:12]]
    assert volumes == [11.0, 44.0, 11.0, 11.0]
    assert not any(row["error"] or row["reference_hypervolume"] or row["igd_plus"] for row in rows)


def test_only_runs_that_are_not_complete_are_trained(start, trainer):
    output = start()
    assert trainer.seeds == [0, 1, 0, 1]
    rows = (output / "rows.csv").read_text()
    folder = output / "hopper" / "two" / "1"
    (folder / compare_jobs.OUTCOME).unlink()
    (folder / "left.txt").write_text("over")
    start()
    assert trainer.seeds == [0, 1, 0, 1, 1]
    assert not (folder / "left.txt").exists()
    assert (output / "rows.csv").read_text() == rows
    start(seeds=(0, 1, 2))
    assert trainer.seeds == [0, 1, 0, 1, 1, 2, 2]


def test_runs_of_other_settings_are_not_mixed(start, trainer):
    start()
    with pytest.raises(MorlaxError, match=r"one/0 was trained with changes .*1\.0.*, not .*1\.5"):
        start({"one": {"ppo.clip": 1.5}})
    with pytest.raises(MorlaxError, match=r"hopper, bad, seed 0: .*clip"):
        start({"good": {}, "bad": {"ppo.clib": 1.0}})
    assert len(trainer.seeds) == 4


def test_a_crash_is_recorded_and_the_rest_goes_on(start, trainer):
    trainer.crashes = {0: 2, 1: 0}
    output = start(seeds=(0, 1, 2))
    assert trainer.seeds == [0, 1, 2] * 2
    rows = csv_rows(output / "rows.csv")
    assert Counter(row["seed"] for row in rows) == {"0": 8, "1": 2, "2": 8}
    assert [row["seed"] for row in rows if row["error"]] == ["0", "1"] * 2
    first, second, third = compare_report.read_runs(output / "rows.csv")[:3]
    assert first.error == second.error == "a loss is not finite,\nat 'this' place"
    assert not third.error
    assert first.best == 11.0  # of the evaluations before the crash
    assert second.best == 0.0
    text = (output / "results.md").read_text()
    assert "- one, seed 0: a loss is not finite, at 'this' place\n" in text
    (line,) = (line for line in text.splitlines() if line.startswith("| one | 11 "))
    assert line.endswith("| 3 | 2 |")
    start(seeds=(0, 1, 2))
    assert len(trainer.seeds) == 6


REFERENCE = {
    "one": {"ppo.clip": 1.0},
    "two": {"ppo.clip": 2.0},
    "best": {"ppo.clip": 4.0, "reference": True, "seconds": 40},
}


def test_runs_are_compared_with_the_union_of_the_reference_s_fronts(start):
    output = start(REFERENCE)
    union = np.concatenate([4.0 * SPHERE, 4.0 * SPHERE + 1])
    volume = pareto.hypervolume(union, np.zeros(2))
    runs = compare_report.read_runs(output / "rows.csv")
    assert {run.reference_hypervolume for run in runs} == {volume}
    for run in runs:
        clip = {"one": 1.0, "two": 2.0, "best": 4.0}[run.method]
        returns = clip * SPHERE + run.seed
        assert run.best == pytest.approx(pareto.hypervolume(returns, np.zeros(2)))
        assert run.reference == (run.method == "best")
        assert run.measures()["% of the reference"] == pytest.approx(100 * run.best / volume)
        assert run.measures()["env steps/s"] == 50
        expected = compare_statistics.scaled_igd_plus(returns, 4.0 * SPHERE + 1)
        assert run.measures()["IGD+"] == pytest.approx(expected)
    assert runs[-1].measures()["IGD+"] == 0
    lines = (output / "results.md").read_text().splitlines()
    two = next(line for line in lines if line.startswith("| two | 5"))
    assert two.startswith("| two | 52.5 (48.25 - 56.75) | ")  # of 44 and 61
    assert two.endswith("| 50 (50 - 50) | 2 | 0 |")
    assert len([row for row in csv_rows(output / "rows.csv") if row["igd_plus"]]) == len(runs)


def test_two_methods_from_training_to_the_report(tmp_path, capsys):
    small = tiny().model_dump(mode="json", exclude={"env", *compare_jobs.OURS})
    dense = {**small, "sampling": {"mode": "dense", "corners": 0}}
    methods, output = written(tmp_path, {"two words": small, "dense": dense}), tmp_path / "out"
    compare.main(output, ("hopper",), methods, (1,), seconds=60.0, device="cpu")
    text = (output / "results.md").read_text()
    assert text in capsys.readouterr().out
    rows = csv_rows(output / "rows.csv")
    # 2 runs with an evaluation after 0, 32 and 64 steps, and of the chosen checkpoint
    assert [row["fresh"] for row in rows] == ["0", "0", "0", "1"] * 2
    config = yaml.safe_load((output / "hopper" / "dense" / "1" / "config.yaml").read_text())
    assert (config["seed"], config["max_seconds"]) == (1, 60.0)
    assert config["sampling"]["mode"] == "dense"
    for name in ("hypervolume", "profile", "interquartile_mean"):
        assert (output / f"{name}.png").exists()


def test_a_search_trains_every_setting_alike_and_writes_the_best(trainer, tmp_path, monkeypatch):
    def fresh_front(folder: Path, device: str) -> Front:
        front, better = trainer.fresh_front(folder, device), "rate 0.002" in folder.parent.name
        return front._replace(returns=front.returns * (3.0 if better else 1.0))

    monkeypatch.setattr(compare, "fresh_front", fresh_front)
    monkeypatch.setattr(compare_report, "save", lambda *_: None)
    methods = written(tmp_path, {"one": {"ppo.clip": 1.0, "seconds": 9}, "N": {"trainer": "nsga2"}})
    arguments = (tmp_path / "out", ("hopper",), methods, (1e-3, 2e-3), (16, 32), (7,), 4.0)
    for share in ("0/2", "1/2", "0/1"):
        search_methods.main(*arguments, share=share, device="cpu")
    settings = yaml.safe_load((tmp_path / "out" / "settings.yaml").read_text())
    assert len(settings) == len(trainer.seeds) == 5
    assert settings["one, learning rate 0.002"] == {"ppo.clip": 1.0, "ppo.learning_rate": 2e-3}
    found = yaml.safe_load((tmp_path / "out" / "searched.yaml").read_text())
    assert found["one"]["tasks"]["hopper"]["ppo.learning_rate"] == 2e-3


def start_script(script: str, *arguments: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, SCRIPT.with_name(f"{script}.py"), *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.long
def test_table1(tmp_path):
    options = ("--env", "cheetah", "--limits", "0.2", "--seeds", "3", "--device", "cpu")
    start_script("table1", *options, folder=tmp_path)
    (row,) = csv_rows(tmp_path / "table1.csv")
    assert (row["env"], row["seed"]) == ("cheetah", "3")
    printed, found = float(row["printed_hypervolume"]), float(row["hypervolume"])
    assert found == pytest.approx(printed, rel=1e-4) and found > 0
    assert float(row["command_seconds"]) > float(row["first_row_seconds"]) > 0
    start_script("table1", *options, folder=tmp_path)
    assert csv_rows(tmp_path / "table1.csv") == [row]  # which exists, so it is not measured again
    assert "| cheetah |" not in (tmp_path / "table1.md").read_text()  # it misses the target


@pytest.mark.slow
def test_throughput(tmp_path):
    output = tmp_path / "rows.csv"
    throughput.main(("hopper",), (128,), device="cpu", seconds=0.1, output=output)
    (row,) = csv_rows(output)
    assert float(row["training/physics"]) > 0
