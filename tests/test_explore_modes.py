"""The explorer's thresholds and several robots, in a real browser."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsing import Client, View, chromium, exploring

from morlax_torch.choose import choose
from morlax_torch.evaluation.front import Front
from morlax_torch.runs.loading import find_run


@pytest.fixture
def view(tmp_path: Path, monkeypatch) -> Iterator[View]:
    """Open the page of the shipped cheetah, with the objectives run and energy."""
    monkeypatch.chdir(tmp_path)
    with exploring("cheetah") as (address, _), chromium() as browser:
        opened = View(browser, address, 1280, 800)
        yield opened
        assert opened.errors == [] and opened.elsewhere == []


@pytest.mark.slow
@pytest.mark.long
def test_a_threshold_in_a_browser_moves_the_sliders_and_draws_a_line(view):
    front = Front.load(find_run("cheetah") / "front.npz")
    view.unfold("at least")
    view.choose("maximize", "energy")
    view.drag_slider("run ≥", 0.5)
    view.until(lambda: view.tab.locator("[data-level]").count() == 1, "there is no line")
    # the page draws what the slider passed on its way, too
    view.until(lambda: view.numbers("level") == (view.slider("run ≥"),), "the line lags behind")
    (least,) = view.numbers("level")
    low, high = front.returns[:, 0].min(), front.returns[:, 0].max()
    assert least == pytest.approx((low + high) / 2, abs=0.1 * (high - low))
    expected = choose("cheetah", {"run": least}, "energy", device="cpu")
    view.tab.wait_for_selector("[data-expected]", timeout=180_000)
    view.until(lambda: view.tradeoff() == pytest.approx(expected.tradeoff, abs=2e-3), "no jump")
    for name, weight in zip(front.objectives, expected.tradeoff, strict=True):
        view.until(lambda n=name, w=weight: view.slider(n) == round(w, 2), f"{name} stays")
    assert view.field() == ", ".join(f"{weight:.3f}" for weight in expected.tradeoff)
    assert f"run {expected.returns['run']:,.0f}" in view.text("expected")
    line = view.tab.locator("[data-level]")
    assert line.get_attribute("stroke-dasharray")
    box, plot = line.bounding_box(), view.tab.locator('[data-cell="0 1"]').bounding_box()
    assert plot["x"] < box["x"] < plot["x"] + plot["width"]

    # a threshold that no policy reaches together with the first: one sentence, and nothing moves
    kept = view.tradeoff()
    view.set_slider("run ≥", least + 0.4 * (high - low))
    view.set_slider("energy ≥", front.returns[:, 1].max() * 0.999)
    view.tab.wait_for_selector("[data-infeasible]", timeout=180_000)
    view.until(lambda: view.tab.locator("[data-level]").count() == 2, "there is no second line")
    sentence = view.text("infeasible")
    assert re.fullmatch(r"no simulated policy keeps [^.]*(\.\d[^.]*)*\.", sentence)
    assert view.tab.locator("[data-expected]").count() == 0
    moved = view.tradeoff()
    assert moved[0] >= kept[0] - 2e-3  # at most the first of both steps moved it, towards run
    view.tab.wait_for_timeout(500)
    assert view.tradeoff() == moved

    view.press("thresholds off")
    view.until(lambda: view.tab.locator("[data-level]").count() == 0, "the lines stay")
    assert view.tab.locator("[data-infeasible]").count() == 0


@pytest.mark.slow
def test_robots_are_added_steered_and_removed_in_a_browser(view):
    drawn = Client(view.tab.url)  # names are drawn in WebGL, where the browser cannot read them
    view.field_box().fill("0.9, 0.1")
    view.until(lambda: view.tradeoff() == (0.9, 0.1), "typing has no effect")
    drawn.named()
    view.press("add a robot")
    drawn.named("1: 0.90, 0.10", "▸ 2: 0.90, 0.10")
    view.until(lambda: view.returns_lines() == ["robot 1", "robot 2"], "no lines of returns")

    # the sliders steer the new robot only
    view.drag_slider("run", 0.2)
    view.until(lambda: abs(view.tradeoff()[0] - view.slider("run")) < 6e-3, "it is not steered")
    second = view.tradeoff()
    name = f"2: {second[0]:.2f}, {second[1]:.2f}"
    drawn.named("1: 0.90, 0.10", f"▸ {name}")

    # each robot keeps its own trade-off
    view.choose("steer robot", "1")
    view.until(lambda: view.tradeoff() == (0.9, 0.1), "the first is not steered")
    view.until(lambda: view.slider("run") == 0.9, "the sliders do not follow")
    drawn.named("▸ 1: 0.90, 0.10", name)

    view.press("remove")
    drawn.named()
    view.until(lambda: view.tradeoff() == second, "the other robot is not steered")
    view.until(lambda: view.returns_lines() == ["this episode"], "the lines of returns stay")
    assert view.tab.get_by_role("button", name="remove").count() == 0
    drawn.close()
