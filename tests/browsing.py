"""The explorer as a command, and two ways to visit it: Chromium, and a websocket of our own."""

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from morlax_torch.viewers.explorer.picking import FIELD

ROOT = Path(__file__).parent.parent
PATIENCE = 120  # s until a page that does not answer counts as broken, also on a busy machine
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
FLAGS = (
    *("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--disable-gpu"),
)
POSE = {
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, -4.0, 1.0],
    "look_at": [0.0, 0.0, 0.5],
    "up_direction": [0.0, 0.0, 1.0],
    "fov": 0.8,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
}


@contextmanager
def exploring(*arguments: str) -> Iterator[tuple[str, subprocess.Popen]]:
    """Serve a run from the current folder; yields the page's address and the process."""
    with serving("explore", *arguments) as served:
        yield served


@contextmanager
def serving(command: str, *arguments: str) -> Iterator[tuple[str, subprocess.Popen]]:
    """Start a command that serves a page; yields the page's address and the process."""
    pytest.importorskip("viser", reason="the extra [explore] is not installed")
    process = subprocess.Popen(
        [sys.executable, "-m", f"morlax_torch.{command}", *arguments, "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
            "PYTHONUNBUFFERED": "1",
        },
    )
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split()[1], process
    finally:
        process.kill()
        process.communicate()


class View:
    """One browser tab and the values that a user reads in it."""

    def __init__(self, browser: Any, address: str, width: int = 800, height: int = 780):
        self.tab = browser.new_page(viewport={"width": width, "height": height})
        self.tab.set_default_timeout(1000 * PATIENCE)
        self.elsewhere: list[str] = []
        self.errors: list[str] = []
        self.tab.on("request", lambda request: self._note(request.url, address))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(address)
        self.tab.wait_for_selector("[data-tradeoff]", state="attached")

    def _note(self, url: str, address: str) -> None:
        if not url.startswith((address, "data:", "blob:")):
            self.elsewhere.append(url)

    def numbers(self, name: str) -> tuple[float, ...]:
        """Return the numbers in the attribute data-`name` of the page's only such element."""
        text = self.tab.locator(f"[data-{name}]").get_attribute(f"data-{name}")
        return tuple(map(float, text.split(",")))

    def tradeoff(self) -> tuple[float, ...]:
        return self.numbers("tradeoff")

    def slider(self, label: str) -> float:
        """Return the number next to the slider with this label."""
        return float(self._row(label).locator("input[inputmode]").input_value())

    def set_slider(self, label: str, value: float) -> None:
        """Type a number next to the slider with this label."""
        self._row(label).locator("input[inputmode]").fill(str(value))

    def drag_slider(self, label: str, share: float) -> None:
        """Drag the slider with this label to a share of its length.

        A drag during which the page rearranges itself misses; it is repeated, as users would.
        """
        self.until(lambda: self._drag(self._row(label), share), f"{label} cannot be dragged")

    def _drag(self, row: Any, share: float) -> bool:
        track, thumb = row.locator(".mantine-Slider-track"), row.get_by_role("slider")
        track.scroll_into_view_if_needed()
        box, mouse = track.bounding_box(), self.tab.mouse
        height = box["y"] + box["height"] / 2
        mouse.move(box["x"] + box["width"] / 3, height)
        mouse.down()
        mouse.move(box["x"] + box["width"] * share, height, steps=4)
        self.tab.wait_for_timeout(200)  # a page that is busy draws a release before the last move
        mouse.up()
        self.tab.wait_for_timeout(200)
        low, high, now = (
            float(thumb.get_attribute(f"aria-value{n}")) for n in ("min", "max", "now")
        )
        return abs((now - low) / (high - low) - share) < 0.03

    def choose(self, label: str, option: str) -> None:
        """Choose an option of the dropdown with this label."""
        self._row(label).locator("input").first.click()
        self.tab.get_by_role("option", name=option, exact=True).click()

    def press(self, name: str) -> None:
        self.tab.get_by_role("button", name=name, exact=True).click()

    def field_box(self) -> Any:
        return self._row(FIELD).locator("input")

    def field(self) -> str:
        return self.field_box().input_value()

    def status(self) -> str:
        return self.tab.locator("b", has_text="this episode").locator("..").inner_text()

    def unfold(self, name: str) -> None:
        """Open a folder of widgets."""
        self.tab.get_by_text(name, exact=True).click()

    def returns_lines(self) -> list[str]:
        """Return what the lines of running returns are named after."""
        names = self.tab.locator("b").all_inner_texts()
        return [name for name in names if name.startswith(("robot ", "this episode"))]

    def text(self, name: str) -> str:
        """Return the text of the page's only element with the attribute data-`name`."""
        return self.tab.locator(f"[data-{name}]").inner_text()

    def until(self, happened: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not happened():
            assert time.monotonic() < deadline, what
            self.tab.wait_for_timeout(50)

    def _row(self, label: str) -> Any:
        exactly = re.compile(f"^{re.escape(label)}$")
        return self.tab.locator("label").filter(has_text=exactly).locator("xpath=../../..")


def middle(locator: Any) -> tuple[float, float]:
    """Return the middle of an element, in pixels of its tab."""
    box = locator.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


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

    `widgets` holds viser's properties of every widget by its uuid, with "label", "value",
    "options" and "content" among them. `notifications` are the texts shown so far.

    Args:
        address: of the page, as the command prints it.
        headers: of the request, such as {"Origin": "http://example.org"}.
        label: of a widget to wait for.
    """

    def __init__(
        self, address: str, headers: dict[str, str] | None = None, label: str = "trade-off"
    ):
        import viser
        from websockets.sync.client import connect

        self._socket = connect(
            "ws" + address.removeprefix("http"),
            additional_headers=headers,
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            max_size=None,
        )
        self.widgets: dict[str, dict[str, Any]] = {}
        self.notifications: list[str] = []
        self.moves = 0  # of anything in the scene
        self.dark = False
        self._names: dict[str, str] = {}  # of robots, by viser's names of the labels
        self.send("ViewerCameraMessage", **POSE)  # viser ignores browsers that have no camera yet
        self.until(lambda: label in self.labels(), "the page has no widgets")

    def close(self) -> None:
        """Leave the page."""
        self._socket.close()

    def send_bytes(self, data: bytes | str) -> None:
        """Send one message as it is."""
        self._socket.send(data)

    def send(self, kind: str, **fields: Any) -> None:
        """Send a message of viser, such as GuiUpdateMessage."""
        import msgspec

        self.send_bytes(msgspec.msgpack.encode({"type": kind, **fields}))

    def set(self, label: str, value: Any) -> None:
        """Send a value for the widget with this label, as if a user had chosen it."""
        self.send("GuiUpdateMessage", uuid=self.uuid(label), updates={"value": value})

    def labels(self) -> list[str]:
        """Return the labels of all widgets."""
        return [fields["label"] for fields in self.widgets.values() if "label" in fields]

    def uuid(self, label: str) -> str:
        """Return viser's name of the widget with this label."""
        return next(u for u, fields in self.widgets.items() if fields.get("label") == label)

    def value(self, label: str) -> Any:
        """Return the last value that the server sent for this widget."""
        return self.widgets[self.uuid(label)]["value"]

    def html(self) -> str:
        """Return the texts and drawings of the page."""
        return "".join(str(fields.get("content", "")) for fields in self.widgets.values())

    def names(self) -> list[str]:
        """Return the names above the robots."""
        return list(self._names.values())

    def named(self, *names: str) -> None:
        """Wait until these are the names above the robots."""
        self.until(lambda: self.names() == list(names), f"the names are not {names}")

    def until(self, happened: Callable[[], bool], what: str) -> None:
        """Receive messages until `happened` returns true, for PATIENCE seconds at most."""
        deadline = time.monotonic() + PATIENCE
        while not happened():
            assert time.monotonic() < deadline, what
            self._receive()

    def _receive(self) -> None:
        import msgspec
        import zstandard

        data = self._socket.recv(timeout=PATIENCE)
        assert isinstance(data, bytes)
        length = int.from_bytes(data[8:16], "little")  # of the metadata; arrays follow
        unpacked = zstandard.ZstdDecompressor().decompress(data[16 : 16 + length])
        for message in msgspec.msgpack.decode(unpacked)["messages"]:
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        match message:
            case {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}:
                self.widgets.setdefault(uuid, {}).update(updates)
            case {"type": "GuiRemoveMessage", "uuid": uuid}:
                self.widgets.pop(uuid, None)
            case {"type": "ThemeConfigurationMessage", "dark_mode": dark}:
                self.dark = dark
            case {"type": "SetPositionMessage"}:
                self.moves += 1
            case {"type": "LabelMessage", "name": name, "props": props}:
                self._names[name] = props["text"]
            case {"type": "SceneNodeUpdateMessage", "name": name, "updates": {"text": text}}:
                self._names[name] = text
            case {"type": "RemoveSceneNodeMessage", "name": name}:
                self._names = {k: v for k, v in self._names.items() if not k.startswith(name)}
            case {"type": "NotificationShowMessage", "props": props}:
                self.notifications.append(props["body"])
            case {"type": str(kind), "uuid": uuid, "props": props} if kind.startswith("Gui"):
                self.widgets[uuid] = {"value": message.get("value"), **props}
