"""The front of a run is that of the checkpoint that `load` loads, and is reported fairly."""

import csv
import os
import shutil
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch
from same import csv_rows
from tiny import learner as learner_of
from tiny import tiny

from morlax_torch import MORLAX, MorlaxError, load
from morlax_torch.commands.evaluate import command as evaluate_command
from morlax_torch.configuration.tradeoffs import dirichlet_tradeoffs
from morlax_torch.evaluation.evaluator import Evaluator, evaluation_worlds
from morlax_torch.evaluation.front import Front
from morlax_torch.exports.exporting import provenance
from morlax_torch.host.files import AnyPath
from morlax_torch.reports.evaluating import evaluate_runs
from morlax_torch.runs import Run, checkpoint
from morlax_torch.runs.choosing import USUAL, trials
from morlax_torch.runs.choosing import choose as choice_of
from morlax_torch.runs.loading import evaluate, find_run, load_front, pack
from morlax_torch.runs.progress import Evaluation, History, hypervolume_of, kept_fronts, read_rows
from morlax_torch.runs.training import Session, make_evaluator
from morlax_torch.train import train

WORSE = {"max_env_steps": 192, "ppo.learning_rate": 0.1}  # the best evaluation is not the last


def write_rows(folder: Path, table: Sequence[dict[str, str]]) -> None:
    with (folder / "metrics.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, dict.fromkeys(name for row in table for name in row))
        writer.writeheader()
        writer.writerows(table)


def returns(run: AnyPath) -> np.ndarray:
    return evaluate(run, device="cpu").returns


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = train(tiny(**WORSE), output=tmp_path_factory.mktemp("runs") / "run").folder
    found = [float(row["hypervolume"]) for row in csv_rows(folder / "metrics.csv")]
    assert found.index(max(found)) < len(found) - 1
    return folder


@pytest.fixture
def run(trained, tmp_path) -> Path:
    return shutil.copytree(trained, tmp_path / "run")


def test_each_checkpoint_has_its_own_front(run):
    for path, front in (
        (run, Front.load(run / "front.npz")),
        (run, load_front(run)),
        (run / "checkpoints/best.pt", load_front(run / "checkpoints/best.pt")),
        (run / "checkpoints/latest.pt", Front.load(run / "checkpoints/latest.npz")),
        (run / "checkpoints/latest.pt", load_front(run / "checkpoints/latest.pt")),
    ):
        np.testing.assert_array_equal(front.returns, returns(path))
        assert front.checkpoint == ("latest.pt" if path.name == "latest.pt" else "best.pt")
    assert load_front(run).hypervolume > load_front(run / "checkpoints/latest.pt").hypervolume


def test_a_front_of_other_policies_is_refused_with_the_command_that_writes_it(run, monkeypatch):
    """Such as after a kill between the two files; training that writes them is waited for."""
    path, before = run / "checkpoints/best.pt", load_front(run)
    content = path.read_bytes()
    shutil.copy(run / "checkpoints/latest.pt", path)
    with monkeypatch.context() as training:
        training.setattr("time.sleep", lambda _: path.write_bytes(content))
        np.testing.assert_array_equal(load_front(run).returns, before.returns)
    shutil.copy(run / "checkpoints/latest.pt", path)
    with pytest.raises(MorlaxError, match=rf"front.npz is of other policies .*evaluate {run}$"):
        load_front(run)
    evaluate_runs([str(run)], "", device="cpu")
    np.testing.assert_array_equal(load_front(run).returns, returns(path))


def test_evaluating_another_checkpoint_leaves_the_run_s_own_files(run, workplace):
    before, other = load_front(run), run / "checkpoints/other.pt"  # saved without an evaluation
    shutil.copy(run / "checkpoints/latest.pt", other)
    with pytest.raises(MorlaxError, match=rf"other.pt has no front .*evaluate {other}$"):
        load_front(other)
    found, folder = evaluate_runs([str(other)], "", tradeoffs=5, device="cpu")
    assert folder.parent == Path("evaluations")
    np.testing.assert_array_equal(load_front(run).returns, before.returns)
    assert len(load_front(other).returns) == 5
    assert [each.front.checkpoint for each in found.values()] == ["other.pt"]
    assert "other.pt" in (folder / "report.html").read_text()


def test_evaluating_a_run_in_training_leaves_the_front_of_newer_policies(run, workplace):
    best = run / "checkpoints/best.pt"
    newer, before = best.read_bytes(), load_front(run)
    shutil.copy(run / "checkpoints/latest.pt", best)
    replaced = {"show": lambda _: best.write_bytes(newer)}
    _, folder = evaluate_runs([str(run)], "", tradeoffs=5, device="cpu", **replaced)
    assert folder.parent == Path("evaluations")
    np.testing.assert_array_equal(load_front(run).returns, before.returns)


NOISY = {"task.reset_noise": 0.1}


def test_a_random_task_has_other_episodes_to_choose_by():
    certain, noisy = (make_evaluator(learner_of(tiny(**changes))) for changes in ({}, NOISY))
    assert len(certain.evaluate_sets()) == 1  # all episodes are alike
    reported, choosing = noisy.evaluate_sets()
    assert not np.isclose(reported.returns, choosing.returns).any()


def scripted(volumes: Sequence[tuple[float, float]], run: Run, learner: MORLAX) -> list[Evaluation]:
    """Train with evaluations of given hypervolumes, reported and choosing."""
    given, evaluator = iter(volumes), make_evaluator(learner)
    front = evaluator.evaluate()._replace(reference_point=np.zeros(2))

    def evaluate_sets() -> list[Front]:
        return [
            front._replace(returns=np.full_like(front.returns, volume**0.5))
            for volume in next(given)
        ]

    evaluator.evaluate_sets = evaluate_sets
    limits = {"max_env_steps": 64 * (len(volumes) - 1), "max_seconds": None}
    evaluation = learner.config.evaluation.model_copy(update={"every": 64})
    learner.config = learner.config.model_copy(update={**limits, "evaluation": evaluation})
    with closing(Session(learner, evaluator, run).training()) as found:
        return list(found)


def test_the_best_checkpoint_is_not_the_one_with_the_luckiest_report(tmp_path):
    learner = learner_of(tiny(**NOISY))
    run = Run.create(learner, tmp_path / "run")
    found = scripted([(1, 2), (9, 3), (4, 5), (5, 4)], run, learner)
    assert [evaluation.best for evaluation in found] == [True, True, True, False]
    table = csv_rows(run.folder / "metrics.csv")
    assert [round(float(row["hypervolume"])) for row in table] == [1, 9, 4, 5]
    assert [row["best"] for row in table] == ["1", "1", "1", "0"]
    assert load_front(run.folder).hypervolume == pytest.approx(4)
    assert Front.load(run.checkpoints / "latest.npz").hypervolume == pytest.approx(5)
    for name in ("best", "latest"):
        progress = checkpoint.load(run.checkpoints / f"{name}.pt").progress
        assert progress.best_hypervolume == pytest.approx(4)
        assert progress.best_selection == pytest.approx(5)
    assert provenance(run.folder)["best_hypervolume"] == pytest.approx(4)


def test_a_random_run_reports_what_evaluate_finds_again(tmp_path):
    randomization = {"friction": (0.5, 2.0), "observation_noise": {"velocity": 0.1}}
    changes = {**NOISY, "task.randomization": randomization, "evaluation.seeds": 2}
    run = train(tiny(**changes), output=tmp_path / "run")
    np.testing.assert_allclose(load_front(run.folder).returns, returns(run.folder), rtol=1e-6)
    other = evaluate(run.folder, device="cpu", seed=np.arange(2)[1])
    assert not np.isclose(other.returns, returns(run.folder)).any()


@pytest.fixture(scope="module")
def trained_discounted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "discounted"
    config = tiny(**WORSE, **{"evaluation.protocol": "discounted"})
    return train(config, output=folder).folder


@pytest.fixture
def discounted(trained_discounted, tmp_path) -> Path:
    return shutil.copytree(trained_discounted, tmp_path / "discounted")


def test_training_measures_by_the_protocol_of_its_config(discounted, tmp_path):
    front, found = load_front(discounted), csv_rows(discounted / "metrics.csv")
    typed = ["--protocol", "discounted", "--tradeoffs", "4", "--device", "cpu", "--output"]
    evaluate_command([str(discounted), *typed, str(tmp_path / "again")])
    again = Front.load(tmp_path / "again" / "front.npz")
    np.testing.assert_array_equal(front.returns, again.returns)
    np.testing.assert_array_equal(front.tradeoffs, dirichlet_tradeoffs(4, 2))
    assert front.reference_point.tolist() == again.reference_point.tolist() == [-100, -100]
    latched = evaluate(discounted, protocol="latched", device="cpu")
    assert not np.isclose(front.returns[:, 0], latched.returns[:, 0], rtol=1e-3).any()
    volumes = [float(row["hypervolume"]) for row in found]
    for name, volume in (("best", max(volumes)), ("latest", volumes[-1])):
        path = discounted / "checkpoints" / f"{name}.pt"
        measured = evaluate(path, protocol="discounted", tradeoffs=4, device="cpu")
        assert measured.hypervolume == pytest.approx(volume)
    assert [row["best"] for row in found][-1] == "0"


def test_evaluate_and_pack_use_the_run_s_own_protocol(discounted, workplace):
    front, file = load_front(discounted), discounted / "front.npz"
    evaluate_runs([str(discounted)], "", device="cpu")
    np.testing.assert_array_equal(load_front(discounted).returns, front.returns)
    pack(discounted, workplace / "packed", "cpu")
    np.testing.assert_array_equal(load_front(workplace / "packed").returns, front.returns)
    before = file.read_bytes()
    _, folder = evaluate_runs([str(discounted)], "", protocol="latched", device="cpu")
    assert folder.parent == Path("evaluations") and file.read_bytes() == before
    shutil.copy(folder / "front.npz", file)
    with pytest.raises(MorlaxError, match="or of another protocol: write"):
        load_front(discounted)
    with pytest.raises(MorlaxError, match="unknown protocol 'Paper': did you mean 'paper'"):
        evaluate(discounted, protocol="Paper", device="cpu")


def test_choose_counts_returns_by_the_run_s_own_protocol(discounted):
    least = float(np.median(load_front(discounted).returns[:, 0]))
    with torch.device("meta"):  # as a user's default
        choice = choice_of(discounted, {"run": least}, "jump", device="cpu")
    policy = load(discounted, "cpu")
    env, point = evaluation_worlds(policy.config, 1, 1), torch.tensor([choice.tradeoff])
    again = Evaluator(policy.agent, env, point, "discounted", alone=True).evaluate()
    np.testing.assert_allclose(choice.values, again.values[0], rtol=1e-6)
    assert choice.returns["run"] >= least
    usual = trials(policy, choice.tradeoff)[USUAL]
    np.testing.assert_allclose(usual.values, choice.values, rtol=1e-6)


def resumed(folder: Path, **changes: object) -> Run:
    run = Run.open(folder)
    return train(tiny(**{**WORSE, "max_env_steps": 256, **changes}), run)


@pytest.mark.parametrize("interrupted", [False, True])
def test_another_protocol_begins_the_record_of_the_best_checkpoint_anew(interrupted, discounted):
    """Although its hypervolumes are smaller; also if the first session ends before it evaluates."""
    before = checkpoint.load(discounted / "checkpoints/best.pt").progress
    rows = len(csv_rows(discounted / "metrics.csv"))
    if interrupted:
        config = tiny(**{**WORSE, "max_env_steps": 256})
        session = Session.of(config, Run.open(discounted))
        assert not list(session.training(stopped=lambda: True))
    resumed(discounted)
    after = checkpoint.load(discounted / "checkpoints/best.pt")
    assert after.progress.best_hypervolume < before.best_hypervolume
    assert load(discounted).config.evaluation.protocol == "latched"
    np.testing.assert_array_equal(load_front(discounted).returns, returns(discounted))
    # curves hold no hypervolumes by the other protocol, from which they would seem to fall or rise
    later = csv_rows(discounted / "metrics.csv")[rows:]
    expected = [float(row["hypervolume"]) for row in later]
    assert History.load(discounted / "metrics.csv").hypervolume.tolist() == expected
    files = {f"{row['iteration']}.npz" for row in later}
    assert {file.name for file in kept_fronts(discounted)} == files


def test_the_record_goes_on_if_evaluations_stay_comparable(run):
    before = checkpoint.load(run / "checkpoints/best.pt").progress
    resumed(run, **{"evaluation.every": 64})
    assert float(csv_rows(run / "metrics.csv")[-1]["hypervolume"]) < before.best_hypervolume
    after = checkpoint.load(run / "checkpoints/latest.pt").progress
    assert after.best_selection == after.best_hypervolume == before.best_hypervolume
    assert checkpoint.load(run / "checkpoints/best.pt").progress == before


def test_curves_hold_no_hypervolumes_of_other_trade_offs(run):
    rows = len(csv_rows(run / "metrics.csv"))
    resumed(run, **{"evaluation.tradeoffs": 3})
    later = [float(row["hypervolume"]) for row in csv_rows(run / "metrics.csv")[rows:]]
    assert History.load(run / "metrics.csv").hypervolume.tolist() == later


def test_the_growth_of_a_front_has_the_one_of_the_best_checkpoint(run):
    """The page tells the hypervolume of the front that it shows."""
    kept, best = kept_fronts(run), Front.load(run / "front.npz").fingerprint
    next(file for file in kept if Front.load(file).fingerprint == best).unlink()
    fronts = kept_fronts(run)
    assert [*fronts.values()] == [*kept.values()] and run / "front.npz" in fronts


def test_both_hypervolume_columns_stay_readable(run):
    """A resumed run with more trade-offs may be measured approximately from then on."""
    table = csv_rows(run / "metrics.csv")
    expected = [float(row["hypervolume"]) for row in table]
    for row in table[2:]:
        row["hypervolume_approximate"] = row.pop("hypervolume")
    write_rows(run, table)
    found = read_rows(run / "metrics.csv")
    assert [hypervolume_of(row) for row in found] == expected
    assert History.load(run / "metrics.csv").hypervolume.tolist() == expected
    assert provenance(run)["best_hypervolume"] == max(expected)
    evaluate_runs([str(run)], "", device="cpu")
    again = resumed(run)
    assert len(csv_rows(again.folder / "metrics.csv")) > len(table)
    assert len(read_rows(run / "metrics.csv")) == len(csv_rows(run / "metrics.csv"))
    for row in table:
        row.pop("hypervolume", None)
    write_rows(run, table)
    with pytest.raises(MorlaxError, match="damaged"):
        read_rows(run / "metrics.csv")


def test_a_folder_of_runs_and_latest_name_the_newest_run(workplace):
    with pytest.raises(MorlaxError, match="there is no run in runs/ yet"):
        find_run("latest")
    for seconds, run in enumerate(("hopper/b", "hopper/a", "ant/c")):
        file = Path("runs") / run / "checkpoints" / "best.pt"
        file.parent.mkdir(parents=True)
        file.touch()
        os.utime(file, (seconds, seconds))
    assert find_run("runs/hopper") == Path("runs/hopper/a")
    assert find_run("latest") == Path("runs/ant/c") == find_run("runs")
    assert find_run("runs/hopper/b") == Path("runs/hopper/b")
    assert find_run("hopper").parent.name == "shipped"


def test_latest_is_also_a_run_of_a_task_with_a_slash_in_its_name(workplace):
    with Run.create(learner_of(tiny("mo-gymnasium/hopper"))) as run:
        assert find_run("latest") == find_run("runs") == run.folder
        assert find_run("runs/mo-gymnasium/hopper") == find_run("runs/mo-gymnasium") == run.folder
