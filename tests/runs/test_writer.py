"""Files are written beside training, and nothing that was evaluated is lost."""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch
from same import rows_of
from tiny import learner, tiny

from morlax_torch import MorlaxError
from morlax_torch.evaluation.front import Front
from morlax_torch.runs import Run, checkpoint
from morlax_torch.runs.progress import Progress
from morlax_torch.runs.training import Schedule, Session, Writer, make_evaluator
from morlax_torch.train import train

EVERY = 64  # steps, or two iterations


class Trial:
    """A run that evaluates after every second iteration and calls `during` before each one."""

    def __init__(self, folder: Path, during: Callable[[int], None], **changes: Any):
        config = tiny(**{"max_env_steps": 99_999, "evaluation.every": EVERY, **changes})
        self.learner = learner(config)
        self.run = Run.create(self.learner, folder)
        self.found: list[int] = []
        self.saved: list[int] = []
        iterate, save = self.learner.iterate, self.run.save

        def observed(done: float) -> None:
            during(self.learner.iteration)
            iterate(done)

        def saved(contents: dict[str, Any], *others: Any) -> None:
            save(contents, *others)
            self.saved.append(contents["learner"]["iteration"])

        self.learner.iterate, self.run.save = observed, saved

    def train(self, **options: Any) -> None:
        evaluator = make_evaluator(self.learner)
        for evaluation in Session(self.learner, evaluator, self.run).training(**options):
            self.found.append(evaluation.iteration)

    def wait_for(self, iteration: int) -> None:
        """Wait until the files of an evaluation are complete."""
        limit = time.monotonic() + 60
        while iteration not in self.saved:
            assert time.monotonic() < limit
            time.sleep(0.01)

    @property
    def rows(self) -> list[int]:
        return [int(row["iteration"]) for row in rows_of(self.run)]

    @property
    def latest(self) -> int:
        learner = checkpoint.load(self.run.checkpoints / "latest.pt").learner
        assert learner is not None
        return learner["iteration"]


@pytest.fixture
def disk(monkeypatch) -> threading.Event:
    """Make evaluations wait for this event before they are written."""
    ready, usual = threading.Event(), Run.log_evaluation

    def slow(*arguments: Any) -> None:
        assert ready.wait(60)
        usual(*arguments)

    monkeypatch.setattr(Run, "log_evaluation", slow)
    return ready


def test_training_goes_on_beside_a_slow_disk_and_an_interrupt_loses_nothing(disk, tmp_path):
    trial = Trial(tmp_path / "run", lambda iteration: None)

    def stopped() -> bool:
        if trial.learner.iteration < 7:
            return False
        assert not trial.rows
        disk.set()
        return True

    trial.train(stopped=stopped)
    assert trial.found == trial.rows == [0, 2, 4, 6]
    assert trial.latest == 7


def test_an_error_in_training_comes_after_what_was_evaluated_before_it(disk, tmp_path):
    def fail(iteration: int) -> None:
        if iteration == 5:
            assert not trial.rows
            disk.set()
            raise MorlaxError("the robot caught fire.")

    trial = Trial(tmp_path / "run", fail)
    with pytest.raises(MorlaxError, match="caught fire"):
        trial.train()
    assert trial.found == trial.rows == [0, 2, 4]
    assert trial.latest == 4


def test_closing_waits_until_everything_is_written(disk, tmp_path):
    disk.set()
    trial = Trial(tmp_path / "run", lambda iteration: None)
    evaluator, began = make_evaluator(trial.learner), time.perf_counter() - 1000
    evaluations = Session(trial.learner, evaluator, trial.run).training(began)
    for number in range(3):
        evaluation = next(evaluations)  # in order, when its files are complete
        assert evaluation.iteration == 2 * number == trial.rows[number]
        assert trial.latest >= evaluation.iteration
        assert evaluation.total_seconds > 1000 > evaluation.train_seconds >= 0
        assert len(Front.load(trial.run.folder / "front.npz").returns) == 4
        assert (trial.run.checkpoints / "best.pt").exists()
    disk.clear()
    threading.Timer(0.2, disk.set).start()
    next(evaluations)
    evaluations.close()
    assert trial.rows == list(range(0, trial.learner.iteration + 1, 2))
    again = Run.open(trial.run.folder)
    again.restore(trial.learner)  # the lock was given back
    again.close()


def test_a_full_disk_ends_training_with_one_error(tmp_path, monkeypatch, capfd):
    def fill(iteration: int) -> None:
        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        if iteration == 3:
            trial.wait_for(2)
            monkeypatch.setattr(os, "fsync", full)

    trial = Trial(tmp_path / "run", fill)
    with pytest.raises(MorlaxError, match=r"cannot write .*metrics.csv: No space left") as error:
        trial.train()
    assert trial.found == trial.rows == [0, 2]
    assert error.value.__context__ is None or isinstance(error.value.__context__, OSError)
    assert capfd.readouterr() == ("", "")
    monkeypatch.undo()
    resumed = train(tiny(max_env_steps=160), Run.open(trial.run.folder))
    assert [row["iteration"] for row in rows_of(resumed)] == ["0", "2", "3", "4", "5"]


def test_a_writer_raises_the_first_error_once_and_drops_later_jobs():
    done: list[str] = []

    def fail() -> None:
        raise MorlaxError("full.")

    with pytest.raises(MorlaxError, match="full"), Writer(most_waiting=4) as writer:
        for job in (lambda: done.append("before"), fail, lambda: done.append("after")):
            writer.put(job)
    assert done == ["before"]
    assert not list(writer.results())


def planned(progress: Progress, iteration: int = 0, device: str = "cpu", **limits: Any) -> Schedule:
    """Return the schedule of a config that has these limits, and none else."""
    unlimited = {"max_env_steps": None, "max_seconds": None, "evaluation.every": None}
    config = tiny(**{**unlimited, "decay_fraction": 0.0, **limits})
    env = SimpleNamespace(device=torch.device(device), recordable=False, episode_length=40)
    learner = SimpleNamespace(
        config=config,
        env=env,
        iteration=iteration,
        steps_per_iteration=100,
        env_steps=100 * iteration,
    )
    return Schedule(cast(Any, learner), progress)


def test_evaluations_are_spaced_by_their_cost():
    progress = Progress(train_seconds=3.0)
    schedule = planned(progress)
    assert schedule.evaluation_due()
    schedule.evaluated(cost=0.8)  # 8 % of ten seconds
    progress.steps_per_second = 1000.0
    for seconds, due, iterations in ((3.0, False, 10), (11.95, False, 3), (12.3, True, 1)):
        progress.train_seconds = seconds
        assert schedule.evaluation_due() == due
        assert schedule.iterations() == iterations


def test_slow_worlds_too_give_a_point_of_the_curves_each_second():
    progress = Progress()
    schedule = planned(progress, **{"evaluation.every": 100_000})
    for speed, iterations in ((1e4, 10), (500.0, 5), (90.0, 1)):  # of 100 steps
        progress.steps_per_second = speed
        assert schedule.iterations() == iterations
        assert schedule.seconds() == 1.0


def test_where_few_worlds_take_as_long_as_many_training_starts_without_an_evaluation():
    progress = Progress()
    schedule = planned(progress, device="cuda")  # horizon 4, so an episode takes ten rollouts
    assert not schedule.evaluation_due() and schedule.seconds() == 0  # after one iteration
    progress.train_seconds, progress.steps_per_second = 0.5, 200.0
    for seconds, due in ((0.5, False), (57.9, False), (58.1, True)):  # 8 % of 62.5 s are 5 s
        progress.train_seconds = seconds
        assert schedule.evaluation_due() == due


@pytest.mark.parametrize(
    ("limits", "done"),
    [
        ({}, 0.0),
        ({"max_env_steps": 1000, "max_seconds": 8.0}, 0.5),
        ({"max_env_steps": 400, "max_seconds": 8.0}, 0.75),
        ({"max_seconds": 2.0}, 1.0),
    ],
)
def test_the_share_of_a_run_that_is_over_is_that_of_the_nearer_limit(limits, done):
    assert planned(Progress(), 3, **limits).done(4.0) == done


def test_a_run_with_spaced_evaluations_has_a_first_and_a_last_one_and_resumes(tmp_path):
    config = tiny(**{"evaluation.every": None})
    run = train(config, output=tmp_path / "run")
    assert [row["iteration"] for row in rows_of(run)][:: len(rows_of(run)) - 1] == ["0", "2"]
    assert (run.checkpoints / "best.pt").exists()
    longer = config.model_copy(update={"max_env_steps": 320})
    resumed = train(longer, Run.open(run.folder))
    reached = [int(row["iteration"]) for row in rows_of(resumed)]
    assert reached == sorted(set(reached)) and {0, 2, 10} <= set(reached)
