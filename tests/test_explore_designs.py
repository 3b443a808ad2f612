"""Sliders for the body of a robot: the page shows it at once, and its front soon."""

from collections.abc import Iterator
from queue import Queue
from typing import Any

import pytest
from browsing import PATIENCE, View, chromium, exploring
from tiny import scaled

import morlax_torch
from morlax_torch import Front, Policy
from morlax_torch.runs.evaluating import evaluate
from morlax_torch.train import train
from morlax_torch.viewers.explorer import lineup
from morlax_torch.viewers.explorer.exhibits import RunExhibit
from morlax_torch.viewers.explorer.library import choose

SMALL = {
    "device": "cpu",
    "worlds": 16,
    "horizon": 5,
    "max_env_steps": 160,
    "sampling.clusters": 4,
    "sampling.designs": 8,
    "ppo.minibatches": 1,
    "evaluation.tradeoffs": 5,
    "task.episode_length": 50,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> str:
    config = morlax_torch.config_for("design/hopper", **SMALL)
    with scaled(0.1):
        return str(train(config, output=tmp_path_factory.mktemp("designs") / "run").folder)


def test_a_slider_changes_the_body_and_then_the_front(folder):
    waiting = Queue[Any]()
    exhibit = RunExhibit(choose(folder, None), waiting.put)
    session = exhibit.behaviors[0]
    robot, model = session.robot, session.model
    assert exhibit.state()["design"] == [0.33, 0.32] and exhibit.state()["measured"]
    exhibit.react({"act": "reshape", "index": 1, "value": 9.0})  # clamped
    design = {"thigh": 0.33, "calf": 0.5}
    assert session.model is not model and session.robot is robot  # the panel stays
    assert session.model.geom("calf").size[1] == pytest.approx(0.25)
    assert exhibit.state()["design"] == [0.33, 0.5] and not exhibit.state()["measured"]
    assert exhibit.state()["choosing"] is None and session.front is None
    exhibit.react({"act": "press", "name": "add"})
    assert len({id(each.player.policy) for each in exhibit.behaviors}) == 1
    exhibit.react({"act": "press", "name": "measure"})
    waiting.get(timeout=PATIENCE)()
    policy = morlax_torch.load(folder).for_design(design)
    expected = evaluate(policy, 33, device="cpu").returns
    for session in exhibit.behaviors:
        assert session.front.returns == pytest.approx(expected)
        assert session.robot is not robot
    assert exhibit.state()["measured"] and exhibit.state()["choosing"] is not None


def test_a_front_of_a_former_body_is_not_shown(folder):
    waiting = Queue[Any]()
    exhibit = RunExhibit(choose(folder, None), waiting.put)
    for value in (0.4, 0.45):
        exhibit.react({"act": "reshape", "index": 0, "value": value})
        if value == 0.4:
            exhibit.react({"act": "press", "name": "measure"})
    waiting.get(timeout=PATIENCE)()
    assert exhibit.behaviors[0].front is None and not exhibit.state()["measured"]


def test_of_many_bodies_the_first_and_the_last_are_evaluated(folder, monkeypatch):
    waiting, evaluated = Queue[Any](), []

    def counted(policy: Policy, *others: Any, **named: Any) -> Front:
        evaluated.append(policy.config.task.design["thigh"])
        return evaluate(policy, *others, **named)

    monkeypatch.setattr(lineup, "evaluate", counted)
    exhibit = RunExhibit(choose(folder, None), waiting.put)
    for value in (0.4, 0.42, 0.44, 0.46):
        exhibit.react({"act": "reshape", "index": 0, "value": value})
        exhibit.react({"act": "press", "name": "measure"})
    while not exhibit.state()["measured"]:
        waiting.get(timeout=PATIENCE)()
    assert evaluated == [0.4, 0.46] and exhibit.behaviors[0].front is not None


def test_robots_with_one_body_have_no_sliders_for_it():
    exhibit = RunExhibit(choose("hopper", None), lambda request: None)
    model = exhibit.behaviors[0].model
    exhibit.react({"act": "reshape", "index": 0, "value": 0.4})
    assert exhibit.behaviors[0].model is model and exhibit.state()["design"] == []


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.mark.slow
def test_a_body_is_changed_in_a_browser(browser, folder):
    with exploring(folder) as (address, _):
        view = View(browser, address)
        view.drag("thigh (m)", 1.0)
        view.until(lambda: view.value("thigh (m)") == 0.5, "the slider does not stay")
        view.moves()
        front = view.tab.locator("#front-section")
        view.until(lambda: "stale" not in (front.get_attribute("class") or ""), "no front comes")
        assert view.value("thigh (m)") == pytest.approx(0.5)
        assert view.errors == []
