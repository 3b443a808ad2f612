"""Training learns, is reproducible, resumes at any moment and reports failures clearly."""

import math
import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import tiny as small
import torch
from same import assert_same, rows_of
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tiny import iterate

from morlax_torch import MORLAX, MorlaxError, evaluate
from morlax_torch.commands import train as train_command
from morlax_torch.commands.terminal import cli
from morlax_torch.commands.terminal.process import exiting_on_signals, interruptible
from morlax_torch.configuration.config import Config, load_config
from morlax_torch.configuration.files import merged, task_values
from morlax_torch.evaluation.front import Front
from morlax_torch.networks.policy import Policy
from morlax_torch.runs import checkpoint
from morlax_torch.runs.progress import Evaluation, kept_fronts
from morlax_torch.runs.run import Run, is_training, milestone
from morlax_torch.train import train


def tiny(env: str = "hopper", **changes: object) -> Config:
    """Return a config for ten iterations of 32 steps, without decay."""
    ten = {"max_env_steps": 320, "evaluation.every": 160, "decay_fraction": 0.0}
    return small.tiny(env, **{**ten, **changes})


def trainer(config: Config, iterations: int) -> MORLAX:
    morlax = small.learner(config)
    iterate(morlax, iterations)
    return morlax


def test_runs_that_begin_at_once_get_a_folder_each(workplace, monkeypatch):
    monkeypatch.setattr(time, "strftime", lambda _: "20261122-120000")
    learners = [trainer(tiny(), 0) for _ in range(4)]
    with ThreadPoolExecutor(4) as threads:
        runs = list(threads.map(Run.create, learners))
    assert {str(run.folder) for run in runs} == {
        f"runs/hopper/20261122-120000-0{number}" for number in ("", "-2", "-3", "-4")
    }
    for run, one in zip(runs, learners, strict=True):
        assert Run.open(run.folder).config() == one.config
    assert len(list(Path("runs/hopper").iterdir())) == 4


@pytest.mark.parametrize(
    "changes",
    [
        {"sampling": {"mode": "dense"}},
        {
            "task": {"reset_noise": 0.01, "stagger": True},
            "sampling": {"corners": 0, "alpha": 0.5},
            "ppo": {"truncation": "mask"},
        },
        {"decay_fraction": 0.5, "ppo.desired_kl": 0.02},
    ],
)
def test_the_same_seed_gives_the_same_run_bit_for_bit(changes):
    one, same = (trainer(tiny(**changes), 4) for _ in range(2))
    assert_same(one.state_dict(), same.state_dict())
    other = trainer(tiny(**changes, seed=1), 4)
    assert not torch.equal(one.rollout.action, other.rollout.action)


def test_modes_of_torch_around_training_and_evaluations_change_no_number(tmp_path):
    plain = train(tiny(), output=tmp_path / "plain").folder
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        same, again = train(tiny(), output=tmp_path / "same").folder, evaluate(plain, device="cpu")
    fronts = [again, *(Front.load(folder / "front.npz") for folder in (plain, same))]
    returns = [front.returns.tolist() for front in fronts]
    assert returns == [returns[0]] * 3


@pytest.mark.parametrize(("fraction", "factor"), [(1.0, 0.6), (0.8, 0.75), (0.5, 1.0)])
def test_learning_rates_and_entropy_decay_until_policies_stop_changing(fraction, factor):
    config = tiny(decay_fraction=fraction, ppo={"entropy": 0.02})
    morlax = trainer(config, 5)  # the fifth iteration begins after 40 % of the run
    ppo, seen = morlax.ppo, morlax.observation.clone()
    assert ppo.entropy.item() == pytest.approx(0.02 * factor)
    assert ppo.optimizers[1].rate.item() == pytest.approx(5e-4 * factor)
    iterate(morlax, 6)
    assert ppo.optimizers[0].rate.item() == ppo.entropy.item() == 0.0
    policy = Policy(morlax.agent, morlax.config, morlax.env.objectives)
    before = policy(seen, (0.3, 0.7))
    iterate(morlax, 2)
    assert torch.equal(policy(seen, (0.3, 0.7)), before)


def test_the_desired_kl_decays_instead_of_a_rate_that_adapts_to_it():
    morlax = trainer(tiny(decay_fraction=1.0, ppo={"desired_kl": 0.02}), 5)
    assert morlax.ppo.desired_kl.item() == pytest.approx(0.02 * 0.6)
    actor, critic = (optimizer.rate.item() for optimizer in morlax.ppo.optimizers)
    assert critic == pytest.approx(5e-4 * 0.6)
    assert actor / 5e-4 == pytest.approx(1.5 ** round(math.log(actor / 5e-4, 1.5)))


def test_a_run_folder_holds_metrics_front_and_checkpoints(tmp_path):
    run = train(tiny(), output=tmp_path / "run")
    rows = rows_of(run)
    assert [row["env_steps"] for row in rows] == ["0", "160", "320"]
    assert set(rows[0]) == {
        *("iteration", "env_steps", "train_seconds", "total_seconds", "steps_per_second"),
        *("hypervolume", "sparsity", "expected_utility", "cardinality", "obedience"),
        *("fall_rate", "blowup_rate", "blowups", "best", "protocol", "series"),
    }
    front = Front.load(run.folder / "front.npz")
    assert front.objectives == ("run", "jump")
    assert front.hypervolume == pytest.approx(max(float(row["hypervolume"]) for row in rows))
    assert {path.name for path in run.checkpoints.iterdir()} >= {"latest.pt", "best.pt"}
    assert run.config() == tiny()


def test_a_run_keeps_the_fronts_of_its_growth_and_the_newest_but_few_of_a_long_run(tmp_path):
    config = tiny(**{"max_env_steps": 32 * 14, "evaluation.every": 32})
    kept = kept_fronts(train(config, output=tmp_path / "run").folder)
    assert [int(file.stem) for file in kept] == [*range(13), 14]
    for file, (steps, _, hypervolume) in kept.items():
        assert steps == 32 * int(file.stem)
        assert Front.load(file).hypervolume == pytest.approx(hypervolume)
    assert sum(map(milestone, range(10_000))) < 100


def test_of_fronts_short_of_the_reference_point_the_last_is_the_best(tmp_path):
    far = {"task": {"reference_point": [1e9, 1e9]}}
    rows = rows_of(train(tiny(**far), output=tmp_path / "run"))
    assert [float(row["hypervolume"]) for row in rows] == [0.0, 0.0, 0.0]
    assert [row["best"] for row in rows] == ["1", "1", "1"]


def test_a_few_seconds_of_training_raise_the_hypervolume(tmp_path):
    small = {"device": "cpu", "backend": "mujoco", "max_env_steps": 80_000}
    small["evaluation"] = {"tradeoffs": 8}
    config = load_config(merged(task_values("cheetah", "cpu"), small))
    run = train(config, output=tmp_path / "run")
    hypervolumes = [float(row["hypervolume"]) for row in rows_of(run)]
    assert hypervolumes[0] < 1.2e6
    assert hypervolumes[-1] > 1.8e6


def iterations(folder: Path) -> int:
    return checkpoint.load(folder / "checkpoints" / "latest.pt").learner["iteration"]


@pytest.mark.parametrize(
    ("number", "status", "words", "evaluated"),
    [
        (signal.SIGINT, 130, ("--evaluation.every", "1280"), True),
        (signal.SIGHUP, 129, ("--max-seconds", "9"), False),  # only at its end
    ],
)
def test_a_signal_ends_training_cleanly_with_a_checkpoint(
    number, status, words, evaluated, workplace, monkeypatch, capsys
):
    iterate = MORLAX.iterate

    def interrupted(morlax: MORLAX, done: float = 0.0) -> None:
        iterate(morlax, done)
        if morlax.iteration == 3:
            held = r"is being trained by another process: wait"
            assert is_training(Path("run"))
            with pytest.raises(MorlaxError, match=held):
                Run.open("run").restore(small.learner(morlax.config))
            os.kill(os.getpid(), number)

    monkeypatch.setattr(MORLAX, "iterate", interrupted)
    typed = "--env", "hopper", *small.TYPED[:-2], *words, "--output", "run"
    monkeypatch.setattr(sys, "argv", ["train", *typed])
    with pytest.raises(SystemExit) as exit:
        cli.run(train_command.command)
    assert exit.value.code == status and not is_training(Path("run"))
    output = " ".join(capsys.readouterr().out.split())
    assert "interrupted" in output and "train --resume run" in output
    assert ("best hypervolume" in output) == evaluated
    assert iterations(workplace / "run") >= 3


def test_a_non_finite_loss_stops_the_run_and_keeps_the_checkpoint(tmp_path):
    network, ppo = {"actor": (64, 64), "critic": (64, 64)}, {"learning_rate": 1.0, "epochs": 4}
    # the last numbers of a processor decide which overflows first
    stops = r"became (nan|inf) in iterations 6 to 10|not finite after iteration 5"
    with pytest.raises(MorlaxError, match=f"({stops}).*latest.pt"):
        train(tiny(network=network, ppo=ppo), output=tmp_path / "run")
    kept = checkpoint.load(tmp_path / "run" / "checkpoints" / "latest.pt")
    assert all(v.isfinite().all() for v in kept.learner["agent"].values())


def test_a_checkpoint_that_could_not_be_read_is_not_written(tmp_path, monkeypatch):
    iterate = MORLAX.iterate

    def overflow(self: MORLAX, done: float) -> None:
        iterate(self, done)
        if self.iteration == 10:
            self.agent.value_normalizer.variance.fill_(math.inf)

    monkeypatch.setattr(MORLAX, "iterate", overflow)
    stop = (
        r"learner\.agent\.value_normalizer\.variance is not finite after iteration 10: try a lower"
    )
    with pytest.raises(MorlaxError, match=stop):
        train(tiny(), output=tmp_path / "run")
    kept = checkpoint.load(tmp_path / "run" / "checkpoints" / "latest.pt")
    assert kept.learner["iteration"] == 5
    assert [row["iteration"] for row in rows_of(Run.open(tmp_path / "run"))] == ["0", "5"]


def test_a_contact_overflow_stops_the_run_and_names_the_option_to_raise(tmp_path):
    task = {"njmax": 8, "episode_length": 500}
    config = tiny("cheetah", backend="warp", task=task, max_env_steps=99999)
    with pytest.raises(MorlaxError, match=r"raise --task.njmax above 8"):
        train(config, output=tmp_path / "run")


def test_training_in_a_thread_reports_every_evaluation(tmp_path):
    found, usual = [], signal.getsignal(signal.SIGINT)

    options = {"output": tmp_path / "run", "on_evaluation": found.append}
    thread = threading.Thread(target=train, args=[tiny()], kwargs=options)
    thread.start()
    thread.join()
    assert [evaluation.env_steps for evaluation in found] == [0, 160, 320]
    rows = rows_of(Run.open(tmp_path / "run"))
    assert [str(e.hypervolume) for e in found] == [row["hypervolume"] for row in rows]
    assert signal.getsignal(signal.SIGINT) is usual


def test_a_tracker_gets_every_point_of_the_curves(tmp_path):
    points = []

    def log_metrics(metrics: dict[str, float], step: int) -> None:  # as MLflow and Trackio do
        points.extend((tag, step, value) for tag, value in metrics.items())

    run = train(tiny(), output=tmp_path / "run", on_metrics=log_metrics)
    events = EventAccumulator(str(run.folder)).Reload()
    written = {
        (tag, event.step): event.value
        for tag in events.Tags()["scalars"]
        for event in events.Scalars(tag)
    }
    assert {(tag, step) for tag, step, _ in points} == written.keys()
    for tag, step, value in points:
        assert written[tag, step] == pytest.approx(value, rel=1e-5)


def test_a_pruned_run_ends_cleanly_and_can_be_resumed(tmp_path):
    class Pruned(Exception):
        pass

    def prune(evaluation: Evaluation) -> None:
        if evaluation.env_steps == 160:
            raise Pruned

    config = tiny()
    with pytest.raises(Pruned):
        train(config, output=tmp_path / "run", on_evaluation=prune)
    assert iterations(tmp_path / "run") >= 5  # training went on while the evaluation was written
    with torch.inference_mode():  # where a user evaluates, too
        resumed = train(config, Run.open(tmp_path / "run"))
    assert [row["env_steps"] for row in rows_of(resumed)] == ["0", "160", "320"]


@pytest.mark.parametrize(
    ("number", "kind"), [(signal.SIGTERM, SystemExit), (signal.SIGINT, KeyboardInterrupt)]
)
def test_a_signal_ends_a_command_also_where_a_library_replaces_its_exception(number, kind):
    with pytest.raises(kind), exiting_on_signals():
        try:
            signal.raise_signal(number)
        except BaseException as error:
            raise RuntimeError("in TorchScript") from error


def test_nohup_protects_a_run_from_its_terminal():
    usual = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with exiting_on_signals(), interruptible() as received:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not received
            os.kill(os.getpid(), signal.SIGTERM)
            assert received == [signal.SIGTERM]
        os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, usual)
