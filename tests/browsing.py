"""The explorer as a command, and two ways to visit it: Chromium, and a websocket of our own."""

import json
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import Program

from morlax_torch import MorlaxError

COMMAND = """
import sys
sys.stdout.reconfigure(line_buffering=True)
from morlax_torch.__main__ import main
main()
"""
PATIENCE = 120  # s until a page that does not answer counts as broken, also on a busy machine
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
FLAGS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--disable-gpu"),
)
# pixels of the screen per pixel of the page: without a graphics card, fewer are drawn far faster
COARSE = {"device_scale_factor": 0.3}
# a page without a graphics card would spend both cores on drawing
FEW_FRAMES = "requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 100)"
RELEASED = """(slider) => {
  slider.released = new Promise((heard) => {
    const tell = () => heard(slider.valueAsNumber);
    addEventListener("pointerup", tell, { capture: true, once: true });
  });
}"""
MOVES = "parseFloat(document.getElementById('clock').textContent) > 0.1"


def needs_page() -> None:
    """Skip without websockets, or without the page's libraries and a network to get them."""
    pytest.importorskip("websockets", reason="the extra [explore] is not installed")
    from morlax_torch.viewers import libraries

    try:
        libraries.files("three")
    except MorlaxError as error:
        pytest.skip(str(error))


@contextmanager
def exploring(*arguments: str) -> Iterator[tuple[str, Program]]:
    """Serve a run from the current folder; yields the page's address and the process."""
    with started("explore", *arguments, "--port", "0") as process:
        yield addressed(process), process


@contextmanager
def started(*words: str) -> Iterator[Program]:
    """Start a command that serves a page."""
    needs_page()
    process = Program(COMMAND, Path.cwd(), words)
    try:
        yield process
    finally:
        process.kill()


def addressed(process: Program) -> str:
    """Wait until a command prints the page's address, and return it."""
    return awaited(process, "open ").split()[1]


def awaited(process: Program, start: str) -> str:
    """Wait until a command prints a line that starts so, and return the line."""
    while True:
        running = process.poll() is None
        for line in process.printed():
            if line.startswith(start):
                return line
        assert running, f"no line starts with {start}"
        time.sleep(0.05)


class View:
    """One browser tab and the values that a user reads in it."""

    def __init__(self, browser: Any, address: str, width: int = 900, height: int = 780):
        self.tab = browser.new_page(viewport={"width": width, "height": height}, **COARSE)
        self.tab.set_default_timeout(1000 * PATIENCE)
        self.elsewhere: list[str] = []
        self.errors: list[str] = []
        self.tab.on("request", lambda request: self._note(request.url, address))
        self.tab.on("console", lambda m: m.type == "error" and self.errors.append(m.text))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.add_init_script(FEW_FRAMES)
        self.tab.goto(address)
        self.tab.wait_for_function(MOVES)

    def _note(self, url: str, address: str) -> None:
        if not url.startswith((address, "data:", "blob:")):
            self.elsewhere.append(url)

    def tradeoff(self) -> tuple[float, ...]:
        return tuple(map(float, self.field().split(",")))

    def field(self) -> str:
        return self.tab.locator("#typed").input_value()

    def slider(self, label: str) -> Any:
        return self.tab.get_by_label(label, exact=True)

    def value(self, label: str) -> float:
        """Return where the slider with this label stands."""
        return float(self.slider(label).input_value())

    def drag(self, label: str, share: float) -> float:
        """Drag the slider with this label to a share of its length, and return its value there."""
        slider = self.slider(label)
        slider.scroll_into_view_if_needed()
        box, mouse = slider.bounding_box(), self.tab.mouse
        height = box["y"] + box["height"] / 2
        mouse.move(box["x"] + box["width"] / 3, height)
        mouse.down()
        mouse.move(box["x"] + 10 + (box["width"] - 20) * share, height, steps=4)
        # a busy page handles these moves later; none is left when it hears of the release
        slider.evaluate(RELEASED)
        mouse.up()
        return slider.evaluate("(slider) => slider.released")

    def press(self, name: str) -> None:
        self.tab.get_by_role("button", name=name, exact=True).click()

    def text(self, place: str) -> str:
        return self.tab.locator(f"#{place}").inner_text()

    def clock(self) -> float:
        """Return the seconds of the episode on the stage."""
        return float(self.text("clock").split()[0])

    def moves(self) -> None:
        """Wait until the robots have moved."""
        before = self.clock()
        self.until(lambda: self.clock() != before, "the robots stand still")

    def names(self) -> list[str]:
        """Return the names above the robots."""
        return self.tab.locator("#names span").all_inner_texts()

    def until(self, happened: Callable[[], bool], what: str) -> None:
        until(self.tab, happened, what)


def until(page: Any, happened: Callable[[], bool], what: str) -> None:
    """Wait until `happened` returns true, for PATIENCE seconds at most."""
    deadline = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < deadline, what
        page.wait_for_timeout(50)


@contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


class Client:
    """A websocket of the explorer that can send what its page never would.

    `about` and `state` are what the server says of the run and of its robots, `told` its errors,
    and `poses` the bodies' positions (robots, nbody, 3) in the latest of `frames`.

    Args:
        address: of the page, as the command prints it.
        headers: of the request, such as {"Origin": "http://example.org"}.
    """

    def __init__(self, address: str, headers: dict[str, str] | None = None):
        from websockets.sync.client import connect

        self._connection = connect(
            f"ws{address.removeprefix('http')}socket",
            additional_headers=headers,
            max_size=None,
            close_timeout=0.5,  # s; what it has not read yet is of no interest
            ping_timeout=None,  # this client answers only while a test waits
        )
        self._socket = self._connection.__enter__()
        self.about: dict[str, Any] = {}
        self.state: dict[str, Any] = {}
        self.told: list[str] = []
        self.frames, self.bodies = 0, 0
        self.poses = np.zeros((0, 0, 3))
        self.until(lambda: self.frames > 0 and bool(self.state), "the page shows nothing")

    def close(self) -> None:
        """Leave the page."""
        self._connection.__exit__(None, None, None)

    def send_bytes(self, data: bytes | str) -> None:
        """Send one message as it is."""
        self._socket.send(data)

    def send(self, act: str, **fields: Any) -> None:
        """Send a message of the page, such as "pause"."""
        self.send_bytes(json.dumps({"act": act, **fields}))

    def tradeoff(self, robot: int = 0) -> list[float]:
        return self.state["robots"][robot]["tradeoff"]

    def moves(self) -> None:
        """Wait until the first robot moves."""
        before = self.poses[0].copy()
        self.until(lambda: bool((self.poses[0] != before).any()), "the robot stands still")

    def until(self, happened: Callable[[], bool], what: str) -> None:
        """Receive messages until `happened` returns true, for PATIENCE seconds at most."""
        deadline = time.monotonic() + PATIENCE
        while not happened():
            assert time.monotonic() < deadline, what
            self._receive()

    def _receive(self) -> None:
        data = self._socket.recv(timeout=PATIENCE)
        if isinstance(data, bytes):
            self._draw(data)
            return
        message = json.loads(data)
        match message.pop("type"):
            case "run":
                self.about = message["about"]
            case "tell":
                self.told.append(message["text"])
            case "state":
                self.state.update(message)

    def _draw(self, data: bytes) -> None:
        kind, length = np.frombuffer(data[:8], np.int32)
        if kind == 0:  # a model
            self.bodies = json.loads(data[8 : 8 + length])["nbody"]
            return
        numbers, at, places = np.frombuffer(data[4:], np.float32), 0, []
        while at < len(numbers):
            _, contacts, ghosts = map(int, numbers[at : at + 3])
            places.append(numbers[at + 3 : at + 3 + 3 * self.bodies].reshape(-1, 3))
            at += 3 + 7 * self.bodies * (1 + ghosts) + 6 * contacts
        self.frames, self.poses = self.frames + 1, np.array(places)
