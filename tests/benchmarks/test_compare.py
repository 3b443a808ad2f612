"""Benchmarks: plans, statistics, rows and tables; not their speed."""

from pathlib import Path

import compare
import compare_report
import compare_statistics
import jobs
import numpy as np
import pytest
import throughput
import yaml
from programs import SERVER, python
from pydantic import ValidationError
from same import csv_rows
from tiny import tiny

from morlax_torch import load
from morlax_torch.runs.loading import evaluate
from morlax_torch.train import train

SCRIPT = Path(compare.__file__)
PLAN = {"tasks": ["hopper"], "seeds": [7, 8], "seconds": 0.3}
SMALL = {"worlds": 64, "evaluation.tradeoffs": 8, "task.episode_length": 50}


@pytest.mark.parametrize("n", (1, 3, 4, 7, 13))
def test_the_interquartile_mean_cuts_a_quarter_at_each_end(n):
    scores = np.random.default_rng(n).normal(size=(3, n))
    for row, mean in zip(scores, compare_statistics.interquartile_mean(scores), strict=True):
        left = sorted(row)
        for _ in range(int(0.25 * n)):
            left = left[1:-1]
        assert mean == pytest.approx(sum(left) / len(left))


def test_pending_jobs_name_files_that_exist():
    for job in jobs.read(SCRIPT.parent / "pending.yaml"):
        words = job.command.split()
        scripts = [
            word for word in words if word.startswith("benchmarks/") and "results" not in word
        ]
        assert all((SCRIPT.parents[1] / name).exists() for name in scripts)


def test_a_bootstrap_interval_of_a_mean_has_its_width():
    scores = np.arange(5.0), 10 + np.arange(8.0) ** 2
    for runs in scores:
        low, high = compare_statistics.interval(compare_statistics.mean, [runs])
        error = runs.std() / len(runs) ** 0.5  # of a mean of independent draws
        assert (low + high) / 2 == pytest.approx(runs.mean(), abs=error / 4)
        assert high - low == pytest.approx(2 * 1.96 * error, rel=0.1)
    low, high = compare_statistics.interval(compare_statistics.mean, scores)
    variance = sum(len(runs) * runs.var() for runs in scores) / 13**2  # runs are drawn by task
    assert high - low == pytest.approx(2 * 1.96 * variance**0.5, rel=0.1)


@pytest.mark.parametrize("path", [*SCRIPT.parent.glob("plans/*.yaml")], ids=lambda path: path.stem)
def test_the_plans_fit_their_tasks(path):
    plan = compare.Plan(**yaml.safe_load(path.read_text()))
    jobs = plan.jobs([], "cpu")
    assert {job.task for job in jobs} == {*plan.tasks}
    assert {job.method for job in jobs} == {*plan.methods}
    assert {job.config("cpu").max_seconds for job in jobs} == {plan.seconds}


def test_a_plan_trains_what_differs_and_refuses_what_it_does_not_know():
    clips = {"default": {}, "0.2": {"ppo.clip": 0.2}, "0.3": {"ppo.clip": 0.3}}  # 0.2 is usual
    of_task = {"one": {}, "two": {"tasks": {"hopper": {"ppo.epochs": 1}}}}
    jobs = compare.Plan(**PLAN, methods=of_task, settings=clips).jobs([], "cpu")
    keys = [(job.method, job.setting, job.seed) for job in jobs]
    assert keys == [(m, s, n) for n in (7, 8) for s in ("default", "0.3") for m in ("one", "two")]
    assert [job.config("cpu").ppo.epochs == 1 for job in jobs] == [False, True] * 4
    with pytest.raises(ValidationError, match="second"):
        compare.Plan(**PLAN, methods={}, second=3)


def test_a_search_gives_further_seeds_to_its_best_settings():
    settings = {name: {"ppo.clip": float(name)} for name in ("0.1", "0.2", "0.3")}
    plan = compare.Plan(**PLAN, methods={"one": {}}, settings=settings, keep=2)
    jobs = plan.jobs([], "cpu")
    assert [job.seed for job in jobs] == [7, 7, 7]
    row = {"task": "hopper", "method": "one", "seed": "7", "evaluation": "noised"}
    volumes = {"0.1": "3", "0.2": "1", "0.3": "2"}
    rows = [{**row, "setting": name, "hypervolume": volumes[name]} for name in volumes]
    assert plan.jobs(rows[:2], "cpu") == jobs
    further = [(job.setting, job.seed) for job in plan.jobs(rows, "cpu")[3:]]
    assert further == [("0.1", 8), ("0.3", 8)]


@pytest.mark.slow
def test_methods_are_trained_until_all_have_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compare, "get_context", lambda method: SERVER)
    plan, output = tmp_path / "plan.yaml", tmp_path / "rows.csv"
    methods = {
        "one": SMALL,
        "two": {**SMALL, "ppo.epochs": 1},
        "bad": {**SMALL, "start_from": "missing.pt"},
    }
    plan.write_text(yaml.safe_dump({**PLAN, "methods": methods}))
    compare.main(plan, output, minutes=5, device="cpu", fronts=tmp_path)
    rows = csv_rows(output)
    assert [row["error"] != "" for row in rows if row["method"] == "bad"] == [True, True]
    for method in ("one", "two"):
        for seed in "78":
            kinds = [r["evaluation"] for r in rows if (r["method"], r["seed"]) == (method, seed)]
            assert set(kinds[:-2]) == {"training"} and kinds[-2:] == ["best", "noised"]
    before = output.read_text()
    compare.main(plan, output, device="cpu")
    assert output.read_text() == before and "0 of 6 runs to train" in capsys.readouterr().out
    drawn = {"targets": ["hopper=1"], "figures": tmp_path, "fronts": tmp_path, "objectives": [2]}
    compare_report.main(output, ours="one", **drawn)
    text = capsys.readouterr().out
    counted = [row for row in rows if (row["method"], row["evaluation"]) == ("one", "noised")]
    middle = np.median([float(row["hypervolume"]) for row in counted])
    power = int(np.log10(middle) // 3) * 3
    assert f"| one | {middle / 10.0**power:#.3g}e{power} (" in text
    for name in ("curves", "differences", "times", "overlaid", "objectives"):
        assert (tmp_path / f"{name}.png").stat().st_size > 5_000


def test_the_episodes_that_count_are_not_those_of_training(tmp_path):
    config = tiny(**{"task.reset_noise": 0.1, "seed": 3})
    policy = load(train(config, output=tmp_path / "run").folder, "cpu")
    fronts = compare.fronts_that_count(policy)
    for other in (fronts["noised"], *(evaluate(policy, seed=seed) for seed in (0, config.seed))):
        np.testing.assert_array_equal(other.tradeoffs, fronts["best"].tradeoffs)
        assert (abs(other.returns - fronts["best"].returns) > 1e-3).all()


@pytest.mark.slow
@pytest.mark.long
def test_table1(tmp_path):
    options = ("--env", "cheetah", "--limits", "0.2", "--seeds", "3", "--device", "cpu")
    tables = []
    for _ in range(2):
        done = python(SCRIPT.with_name("table1.py"), *options, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        tables.append(csv_rows(tmp_path / "table1.csv"))
    ((row,), again) = tables
    assert again == [row]  # which existed, so it was not measured again
    assert (row["env"], row["seed"]) == ("cheetah", "3")
    printed, volume = float(row["printed_hypervolume"]), float(row["hypervolume"])
    assert volume == pytest.approx(printed, rel=1e-4) and volume > 0
    assert float(row["command_seconds"]) > float(row["first_row_seconds"]) > 0
    assert "| cheetah |" not in (tmp_path / "table1.md").read_text()  # it misses the target


@pytest.mark.slow
def test_throughput(tmp_path):
    output = tmp_path / "rows.csv"
    throughput.main(("hopper",), (128,), device="cpu", seconds=0.1, output=output)
    (row,) = csv_rows(output)
    assert float(row["training/physics"]) > 0
