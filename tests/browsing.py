"""The explorer as a command, and two ways to visit it: Chromium, and a websocket of our own."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

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
    pytest.importorskip("viser", reason="the extra [explore] is not installed")
    process = subprocess.Popen(
        [sys.executable, "-m", "morlax_torch.explore", *arguments, "--port", "0"],
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
    """

    def __init__(self, address: str, headers: dict[str, str] | None = None):
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
        self.send("ViewerCameraMessage", **POSE)  # viser ignores browsers that have no camera yet
        self.until(lambda: "trade-off" in self.labels(), "the page has no widgets")

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
            case {"type": "NotificationShowMessage", "props": props}:
                self.notifications.append(props["body"])
            case {"type": str(kind), "uuid": uuid, "props": props} if kind.startswith("Gui"):
                self.widgets[uuid] = {"value": message.get("value"), **props}
