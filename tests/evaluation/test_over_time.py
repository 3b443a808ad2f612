"""A trade-off that changes over an episode reaches what no constant one can."""

from pathlib import Path

import numpy as np
import pytest
import test_choose
import torch
import yaml
from closed_form import PLACES

from morlax_torch import MorlaxError, Policy, envs, load, save
from morlax_torch.commands import choose, record
from morlax_torch.configuration.schedules import Schedule
from morlax_torch.evaluation.evaluator import Evaluator
from morlax_torch.runs.loading import evaluate, load_front
from morlax_torch.tuning import evolution, schedules
from morlax_torch.viewers.filming.recording import Film
from morlax_torch.viewers.player import Player

FILE = "tradeoff_over_time.yaml"
FAST = 140.0
UTILITY = ("--at-least", f"run={FAST} @ 0.4-0.8", "--maximize", "energy")


@pytest.fixture(scope="module")
def cheetah(tmp_path_factory) -> Path:
    """Return a run of the shipped cheetah in episodes of two seconds, with 32 trade-offs."""
    policy, folder = load("cheetah"), tmp_path_factory.mktemp("run")
    policy.config = policy.config.with_task(episode_length=200)
    (folder / "checkpoints").mkdir()
    save(policy, folder / "checkpoints" / "best.pt")
    evaluate(policy, device="cpu", tradeoffs=32).save(folder / "front.npz")
    return folder


def played(policy: Policy, tradeoff) -> tuple[float, float]:
    """Return the return of run in the window and that of energy in all, of one robot."""
    player, runs = Player(policy, tradeoff), []
    while not player.over:
        runs.append(player.step().reward[0, 0].item())
    return sum(runs[40:80]), player.returns[1].item()


def test_a_film_shows_a_robot_that_is_fast_in_time_and_saves_more_than_a_constant(
    cheetah, tmp_path, monkeypatch, capsys, opengl
):
    monkeypatch.setattr(schedules, "POPULATION", 32)
    monkeypatch.setattr(schedules, "ROUNDS", {"constant": 2, "over time": 8})
    monkeypatch.chdir(tmp_path)
    choose.command([str(cheetah), "--over-time", *UTILITY, "--device", "cpu"])
    lines = capsys.readouterr().out.splitlines()
    policy, file = load(cheetah), cheetah / FILE
    schedule = Schedule.load(str(file), policy.objectives)
    run, energy = played(policy, schedule)
    (row,) = [line.split() for line in lines if line.split()[:1] == ["energy"]]
    assert float(row[1]) == pytest.approx(energy, abs=0.05) and run >= FAST
    assert {"times", "weights", "name"} == yaml.safe_load(file.read_text()).keys()

    constants = [played(policy, (w, 1 - w)) for w in np.linspace(0, 1, 33)]
    best = max(energy for run, energy in constants if run >= FAST)
    most = max(energy for _, energy in constants)
    assert most - energy < 0.9 * (most - best)  # of energy is spent
    films, strip = [], Film.strip
    monkeypatch.setattr(Film, "strip", lambda *given: films.append(given[0]) or strip(*given))
    small = ("--width", "95", "--height", "65", "--seconds", "2", "--output", "film.png")
    record.command([str(cheetah), "--tradeoff", str(file), *small])
    assert films[0]._takes[0].player.returns[1].item() == energy


def test_weights_change_no_faster_than_the_slew(cheetah):
    searching = schedules.Scheduler(load(cheetah), {}, "energy", {}, knots=5, slew=0.6)
    wanted = np.array([1.0, 0.0, 0.0, 0.0, 0.9])  # every 0.5 s
    assert len(searching._times) == 5
    (limited,) = searching._limited(np.stack([wanted, 1 - wanted], 1)[None])
    np.testing.assert_allclose(limited[:, 0], [1.0, 0.7, 0.4, 0.1, 0.4], atol=2e-5)
    np.testing.assert_allclose(limited.sum(1), 1, atol=1e-9)


def test_of_a_window_written_in_two_ways_the_strictest_requirement_counts(cheetah):
    least = {"run @ 0-1": 50.0, "run @ 0.0-1.0": 40.0}
    most = {"energy @ 1-2": 70.0, "energy @ 1-2.0": 80.0}
    required = schedules.Scheduler(load(cheetah), least, "energy", most).required
    assert {required.names[limit.index]: limit.level for limit in required.limits} == {
        "run @ 0-1 s": 50.0,
        "energy @ 1-2 s": 70.0,
    }


def test_a_window_lies_in_the_steps_that_discounted_returns_count(cheetah):
    policy = load(cheetah)
    config = policy.config.with_task(episode_length=700)
    discounted = config.evaluation.model_copy(update={"protocol": "discounted"})
    policy.config = config.model_copy(update={"evaluation": discounted})
    with pytest.raises(MorlaxError, match="ends after 5 s"):
        schedules.Scheduler(policy, {"run @ 6-7": 1.0}, "energy", {})


def test_no_other_finalist_of_a_random_task_is_better(monkeypatch):
    small = {"POPULATION": 8, "FINALISTS": 2, "ROUNDS": {"constant": 2, "over time": 3}}
    for name, value in small.items():
        monkeypatch.setattr(schedules, name, value)
    policy = load("cheetah", "cpu")
    policy.config = policy.config.with_task(episode_length=30, reset_noise=1.0)
    scheduler = schedules.Scheduler(policy, {}, "run @ 0-0.1", {}, seeds=2, seed=2)
    _, best = scheduler.search(load_front("cheetah"))
    values = {name: each.values[0, scheduler.required.maximized] for name, each in best.items()}
    assert values["over time"] == max(values.values())


def test_a_requirement_is_kept_even_if_all_of_the_best_were_lucky(monkeypatch):
    policy = load("cheetah", "cpu")
    policy.config = policy.config.with_task(episode_length=30, reset_noise=1.0)
    scheduler = schedules.Scheduler(policy, {"run": 0.5}, "energy", {}, seeds=2)
    searching = scheduler._evaluator

    def simulate(scheduler, weights: np.ndarray) -> schedules.Simulated:
        run, luck = weights[:, :, 0].mean(1), 0.3 * (scheduler._evaluator is searching)
        return schedules.Simulated(weights, np.stack([run + luck, 1 - run], 1), 0 * run)

    monkeypatch.setattr(schedules.Scheduler, "_simulate", simulate)
    _, best = scheduler.search(load_front("cheetah"))
    assert 0.5 <= best["over time"].values[0, 0] < 0.8


def test_a_search_takes_any_seed_that_worlds_take():
    def score(drawn: np.ndarray) -> np.ndarray:
        assert len(drawn) == 4
        return drawn

    evolution.evolve({"weight": (0, 1)}, np.zeros((1, 1)), 1, 4, 1, 2**63 - 1, score)


def test_quantities_of_a_window_are_those_of_its_steps(tmp_path):
    class Walking(test_choose.Powered):
        class Options(test_choose.Powered.Options):
            episode_length: int = 7

        episode_length, dt = 7, 0.5

    policy = load(test_choose.separate(tmp_path / "run", "walking", Walking))
    env = envs.make("walking", 1, "cpu", auto_reset=False)
    evaluator = Evaluator(policy.agent, env, torch.tensor([[1.0, 0.0]]))
    times, corners = np.array([0.0, 1.5, 1.6, 4.0]), np.eye(2)[[0, 0, 1, 1]]
    windows = [(0.0, 1.5), (2.0, 3.0), (0.0, 3.5), (0.75, 1.25)]  # the last between steps
    values, falls = evaluator.follow(Schedule(times, corners[None]).at, windows)
    first, second = PLACES[:, 0].tolist()
    speeds = values[:, 0, -1]
    np.testing.assert_allclose(speeds[[0, 1, 3]], [first, second, first], atol=1e-5)
    assert values[2, 0, 0] > values[0, 0, 0] and falls.tolist() == [1.0]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--at-least", "run=9 @ 1-6", "--maximize", "energy"), "ends after 2 s"),
        (("--at-least", "run=9 @ 1", "--maximize", "energy"), "@ 0-1"),
        (("--at-least", "rum=9 @ 0-1", "--maximize", "energy"), "'rum'"),
        ((*UTILITY, "--knots", "1"), "knots"),
        ((*UTILITY, "--card", "card.html"), "leave --over-time out"),
        ((*UTILITY, "--output", "/dev/null/a.yaml"), "cannot make /dev/null"),
    ],
)
def test_a_mistake_is_refused_in_one_sentence(words, sentence, cheetah, refused):
    assert sentence in refused(choose, cheetah, "--over-time", *words, "--device", "cpu")


def test_a_part_of_a_motion_is_refused(cheetah, refused, monkeypatch):
    monkeypatch.setattr(envs.Worlds, "follows_part", True)
    assert "parts of its motion, or of several" in refused(choose, cheetah, "--over-time", *UTILITY)


def test_a_window_needs_a_trade_off_over_time_and_a_file_its_objectives(cheetah, refused, tmp_path):
    assert "needs --over-time" in refused(choose, cheetah, *UTILITY)
    file = tmp_path / "x.yaml"
    Schedule(np.array([0.0, 0.0]), np.eye(2)).save(file, ("run", "energy"))
    assert "rising seconds" in refused(record, cheetah, "--tradeoff", file)
    Schedule(np.array([0.0, 1.0]), np.eye(2)).save(file, ("run", "jump"))
    assert "energy" in refused(record, cheetah, "--tradeoff", file)
