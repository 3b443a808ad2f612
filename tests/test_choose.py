"""A trade-off is chosen by what its policy must reach."""

import numpy as np
import pytest

from morlax_torch import MorlaxError, choose
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.loading import find_run
from morlax_torch.terminal import cli


@pytest.fixture
def circle() -> Front:
    """Return 11 trade-offs whose returns lie on a quarter circle."""
    weights = np.linspace(0, 1, 11)
    angle = np.arctan2(weights, 1 - weights)
    returns = 100 * np.stack([np.sin(angle), np.cos(angle)], 1)
    points = np.stack([weights, 1 - weights], 1)
    return Front(("run", "save"), points, returns, np.full(11, 9), np.zeros(2))


@pytest.mark.parametrize("least", [0.0, 33.0, 70.0, 99.0])
def test_the_choice_just_meets_its_constraint(circle, least):
    found = choose.choose(circle, {"run": least}, "save")
    assert found.returns["run"] >= least
    assert found.returns["save"] == pytest.approx((100**2 - least**2) ** 0.5, rel=0.12, abs=1.0)
    near = np.abs(circle.tradeoffs - found.tradeoff).sum(1).argmin()
    assert np.abs(circle.returns[near] - list(found.returns.values())).max() < 10


def test_without_a_constraint_the_best_policy_is_chosen(circle):
    assert choose.choose(circle, {}, "run").returns["run"] == pytest.approx(100)


@pytest.mark.parametrize("name", ["cheetah3", "bruce"])
def test_a_choice_is_at_least_as_good_as_evaluated_policies(name):
    front = Front.load(find_run(name) / "front.npz")
    first, second, *_ = front.objectives
    middle = float(np.median(front.returns[:, 0]))
    found = choose.choose(front, {first: middle}, second)
    assert found.returns[first] >= middle
    evaluated = front.returns[front.returns[:, 0] >= middle][:, 1].max()
    assert found.returns[second] >= evaluated
    assert sum(found.tradeoff) == pytest.approx(1)


def test_the_command_prints_a_trade_off(monkeypatch, capsys):
    arguments = ["cheetah", "--constrain", "run >= 2000", "--maximize", "energy"]
    monkeypatch.setattr("sys.argv", ["choose", *arguments])
    cli.run(choose.command)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[0] == "run" and float(lines[0].split()[1]) >= 2000
    assert lines[-1].startswith("trade-off: ")


MISTAKES = {
    "an unknown objective": ({"rum": 1.0}, "save", "unknown objective 'rum': did you mean 'run'"),
    "nothing to maximize": ({}, "sav", "unknown objective 'sav': did you mean 'save'"),
    "too much": ({"run": 120.0}, "save", "no policy reaches run >= 120: the most is 100, 20 less"),
    "too much at once": (
        {"run": 90.0, "save": 90.0},
        "run",
        r"at once: the nearest has run 7\d\.?\d* instead of 90, save 7\d\.?\d* instead of 90",
    ),
}


@pytest.mark.parametrize(("constraints", "maximize", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_one_sentence(circle, constraints, maximize, message):
    with pytest.raises(MorlaxError, match=message):
        choose.choose(circle, constraints, maximize)


def test_the_strictest_of_several_constraints_on_an_objective_counts(monkeypatch, capsys):
    constraints = ["--constrain", "run >= 2000", "--constrain", "run >= 100"]
    monkeypatch.setattr("sys.argv", ["choose", "cheetah", *constraints, "--maximize", "energy"])
    cli.run(choose.command)
    assert float(capsys.readouterr().out.split()[1]) >= 2000


@pytest.mark.parametrize("text", ["run > 3", "run >= nan", "run >= inf", ">= 3"])
def test_a_constraint_that_cannot_be_read_is_refused(text, monkeypatch, capsys):
    arguments = ["cheetah", "--constrain", text, "--maximize", "energy"]
    monkeypatch.setattr("sys.argv", ["choose", *arguments])
    with pytest.raises(SystemExit):
        cli.run(choose.command)
    assert f"{text!r} is not a constraint: write OBJECTIVE >= NUMBER" in " ".join(
        capsys.readouterr().err.split()
    )
