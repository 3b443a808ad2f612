"""The explorer's page: errors of the command, and its behavior in a real browser."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsing import PATIENCE, View, chromium, exploring, middle

from morlax_torch.commands import explore
from morlax_torch.viewers.explorer import library, weights
from morlax_torch.viewers.explorer.opening import free_port


def test_a_run_that_cannot_be_explored_is_an_error(workplace, monkeypatch, refused):
    monkeypatch.setattr(library, "SHIPPED", workplace)
    assert "there is nothing to explore yet" in refused(explore)
    assert "runs/none does not exist" in refused(explore, "runs/none")
    (workplace / "run").mkdir()
    assert "run has no checkpoints" in refused(explore, "run")


def test_an_address_that_cannot_be_listened_on_is_an_error(workplace, make_run, refused):
    make_run(workplace / "run", "hopper", "best")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert port < free_port("127.0.0.1", port) < port + 20
    assert "from 0 to 65535" in refused(explore, "run", "--port", "70000")
    for host in ("192.0.2.1", "..", "a" * 70, "é..", "a\0b", ""):
        text = refused(explore, "run", "--host", host)
        assert "cannot listen on" in text and "choose another --port or --host" in text


def test_without_viser_the_error_names_the_extra(workplace, make_run, monkeypatch, refused):
    make_run(workplace / "run", "hopper", "best")
    for name in [name for name in sys.modules if name.startswith("morlax_torch.viewers.explorer.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    text = refused(explore, "run", "--port", "0")
    assert "pip install 'morlax-torch[explore]'" in text


# in a browser


@pytest.fixture
def served(workplace, make_run) -> Iterator[tuple[str, subprocess.Popen]]:
    """Serve a run with three objectives; yields the page's address and the process."""
    make_run(workplace / "runs/cheetah3/a", "cheetah3", "best", "latest")
    make_run(workplace / "runs/hopper/b", "hopper", "best")
    make_run(workplace / "runs/bruce/c", "bruce", "best")
    with exploring("runs/cheetah3/a") as process:
        yield process


WAITING = """
import signal, threading, time
from morlax_torch.viewers.explorer.serving import Requests

def interrupt(thread):
    while True:
        time.sleep(0.003)
        signal.pthread_kill(thread, signal.SIGINT)

def keep_busy():
    while True:
        sum(range(2000))

signal.signal(signal.SIGINT, lambda number, frame: None)
threading.Thread(target=keep_busy, daemon=True).start()
threading.Thread(target=interrupt, args=(threading.get_ident(),), daemon=True).start()
requests = Requests(None)
for _ in range(200):
    requests.execute(0.002)
"""


def test_the_wait_for_requests_ends_whenever_a_signal_comes():
    subprocess.run([sys.executable, "-c", WAITING], timeout=PATIENCE, check=True)


@pytest.fixture
def browser() -> Iterator:
    with chromium() as browser:
        yield browser


@pytest.mark.slow
def test_a_browser_steers_the_robot(served, browser, tmp_path):
    address, _ = served
    view = View(browser, address)
    shots = Path(os.environ.get("MORLAX_SCREENSHOTS", tmp_path))

    # the robot moves, and every request goes to the served address
    before = view.status()
    view.until(lambda: view.status() != before, "the robot stands still")
    assert view.elsewhere == []
    assert view.tradeoff() == pytest.approx((1 / 3,) * 3, abs=1e-3)

    # drag a slider: the other weights shrink in proportion
    view.drag_slider("run", 0.8)
    view.until(lambda: view.tradeoff()[0] == pytest.approx(0.8, abs=0.03), "slider has no effect")
    first, *others = view.tradeoff()
    assert others == pytest.approx([(1 - first) / 2] * 2, abs=2e-3)
    view.until(
        lambda: view.slider("energy") == pytest.approx(others[0], abs=6e-3), "sliders differ"
    )
    assert weights.read(view.field(), 3) == pytest.approx(view.tradeoff(), abs=2e-3)
    view.tab.screenshot(path=shots / "slider.png")

    # click the front: the policy changes and its mark moves
    corner = view.tab.locator('[data-cell="0 1"] [data-w="0.000, 1.000, 0.000"]')
    view.tab.mouse.click(*middle(corner))
    view.until(lambda: view.tradeoff() == (0, 1, 0), "the click has no effect")
    assert middle(view.tab.locator("[data-here]").first) == pytest.approx(middle(corner), abs=1)
    view.until(
        lambda: [view.slider(o) for o in ("run", "energy", "height")] == [0, 1, 0],
        "the sliders do not follow",
    )

    # drag the point of the triangle, also beyond an edge
    triangle = view.tab.locator("polygon").bounding_box()
    x, y = triangle["x"] + triangle["width"] / 2, triangle["y"] + triangle["height"]
    view.tab.mouse.move(x, y - triangle["height"] / 3)
    view.tab.mouse.down()
    view.until(lambda: view.tradeoff() == pytest.approx((1 / 3,) * 3, abs=0.04), "no drag starts")
    view.tab.mouse.move(x, y + 60)
    view.until(
        lambda: view.tradeoff() == pytest.approx((0, 0.5, 0.5), abs=0.03), "drag has no effect"
    )
    view.tab.mouse.up()

    # type and copy a trade-off
    view.field_box().fill("2, 1, 1")
    view.until(lambda: view.tradeoff() == (0.5, 0.25, 0.25), "typing has no effect")
    view.tab.mouse.click(*middle(corner))
    view.until(lambda: view.tradeoff() == (0, 1, 0), "the second click has no effect")
    view.tab.get_by_role("button", name="copy", exact=True).click()
    view.field_box().fill("")
    view.field_box().press("Control+v")
    assert view.field() == "0.000, 1.000, 0.000"
    view.tab.screenshot(path=shots / "front.png")


@pytest.mark.slow
@pytest.mark.long
def test_the_robot_keeps_running_when_browsers_leave(served, browser, tmp_path):
    address, process = served
    first, second = View(browser, address), View(browser, address, 390, 844)
    shots = Path(os.environ.get("MORLAX_SCREENSHOTS", tmp_path))
    second.tab.screenshot(path=shots / "phone.png")

    # both tabs show the same robot
    first.field_box().fill("1, 3, 0")
    second.until(lambda: second.tradeoff() == (0.25, 0.75, 0), "the other tab does not follow")

    # one tab closes in the middle of a drag
    track = first.tab.locator(".mantine-Slider-track").first.bounding_box()
    first.tab.mouse.move(track["x"] + 10, track["y"] + track["height"] / 2)
    first.tab.mouse.down()
    first.tab.close()
    second.tab.close()
    third = View(browser, address)
    assert sum(third.tradeoff()) == pytest.approx(1, abs=2e-3)
    before = third.status()
    third.until(lambda: third.status() != before, "the robot stands still")

    # pause and resume
    third.tab.get_by_role("button", name="pause").click()
    third.tab.get_by_role("button", name="resume").wait_for()
    third.tab.wait_for_timeout(300)
    before = third.status()
    third.tab.wait_for_timeout(500)
    assert third.status() == before
    third.tab.get_by_role("button", name="push").click()
    third.tab.get_by_role("button", name="reset").click()
    third.until(lambda: "0.0 s" in third.status(), "the episode is not reset")
    third.tab.get_by_role("button", name="resume").click()

    # another run, with other objectives
    third.tab.get_by_label("policy").first.click()
    third.tab.get_by_role("option", name="runs/hopper/b").click()
    third.until(lambda: len(third.tradeoff()) == 2, "the other run is not shown")
    assert third.slider("run") + third.slider("jump") == pytest.approx(1)
    third.tab.wait_for_timeout(500)
    third.tab.screenshot(path=shots / "another.png")

    # a run with six objectives and a velocity command
    third.tab.get_by_label("policy").first.click()
    third.tab.get_by_role("option", name="runs/bruce/c").click()
    third.until(lambda: len(third.tradeoff()) == 6, "the third run is not shown")
    third.until(lambda: third.slider("m/s forward") == 0.12, "the velocity command is not shown")
    assert third.slider("m/s to the left") == 0
    assert third.slider("smooth") == pytest.approx(1 / 6, abs=5e-3)
    third.tab.wait_for_timeout(500)
    third.tab.screenshot(path=shots / "command.png")

    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert errors == "" and output == ""
