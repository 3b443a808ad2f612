"""The page: a server, the robots that it shows, and the loop that runs both."""

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from websockets.asyncio.server import ServerConnection

from .. import libraries
from ..page_files import page_files
from . import messages
from .behavior import MAX_LAG
from .describing import described, frame_bytes, model_bytes, told
from .exhibits import Exhibit
from .requests import Put, Requests
from .server import Server

FRAME = 1 / 40  # s between frames
TELL = 1 / 10  # s between messages about anything but poses
SLOWEST = 0.05  # playback speed


class Page:
    """A server and the robots that it shows; `serve` runs both.

    Only the thread of `serve` uses the robots: browsers queue their requests. A step that fails
    also pauses the robots, and browsers that connect later are told why. `address` is what a
    browser must open; it contains a secret token.

    Args:
        make: makes what is shown, given a way to queue requests.
        host: address to listen on.
        port: TCP port to listen on; 0 selects a free one.

    Raises:
        MorlaxError: `make` failed, three.js cannot be downloaded, or the port is taken.
    """

    def __init__(self, make: Callable[[Put], Exhibit], host: str, port: int):
        self._requests = Requests(self._tell)
        self._exhibit = make(self._requests.put)
        self._paused, self._pace = False, 1.0
        self._failure: str | None = None  # why the robots paused by themselves
        self._opening: messages.Open | None = None  # the last run that was asked for
        self._robot: object = None  # that browsers know
        self._about, self._model = "", b""  # messages about it
        self._drawn: object = None  # its model, which a new body replaces
        self._state: dict[str, Any] = {}  # that they know
        self._server = Server(files(), host, port, self._hear, self._greet)
        self.address = self._server.address

    def serve(self, ended: Callable[[], bool]) -> None:
        """Move the robots in real time and serve browsers until `ended` returns true."""
        frame = shown = 0.0
        while not ended():
            now = time.perf_counter()
            failure = self._requests.attempt(partial(self._advance, now))
            if failure is not None:
                self._paused, self._failure = True, failure
            if now >= shown:
                shown = now + TELL
                self._show()
            if now >= frame:
                frame = now + FRAME
                self._draw()
            waits = [behavior.until_next() for behavior in self._exhibit.behaviors]
            wait = min(*waits, MAX_LAG, frame - time.perf_counter())
            self._requests.execute(max(wait, 0.0))

    def stop(self) -> None:
        """Stop the server and disconnect the browsers."""
        self._server.stop()

    def _advance(self, now: float) -> None:
        for behavior in self._exhibit.behaviors:
            behavior.paused, behavior.pace = self._paused, self._pace
            behavior.advance(now)

    def _draw(self) -> None:
        """Send where the robots are; before that, which robots these are."""
        first = self._exhibit.behaviors[0]
        if self._robot is not first.robot or self._drawn is not first.model:
            self._show()
        frame = frame_bytes(self._exhibit.behaviors)
        if frame is not None:
            self._server.send(frame)

    def _show(self, to: ServerConnection | None = None) -> None:
        """Send what has changed to all browsers, or everything to one."""
        first = self._exhibit.behaviors[0]
        if self._robot is not first.robot:
            self._robot = first.robot
            self._about = json.dumps({"type": "run", "about": described(first)})
            self._server.send(self._about)
            self._drawn = None
        if self._drawn is not first.model:
            self._drawn, self._model = first.model, model_bytes(first.model)
            self._server.send(self._model)
        state = self._described()
        if to is not None:
            for message in (self._about, self._model, json.dumps({"type": "state", **state})):
                self._server.send(message, to)
            self._server.join(to)
        news = {k: v for k, v in state.items() if k not in self._state or self._state[k] != v}
        self._state = state
        if news:
            self._server.send(json.dumps({"type": "state", **news}))

    def _described(self) -> dict[str, Any]:
        robots = [told(behavior) for behavior in self._exhibit.behaviors]
        playback = {"paused": self._paused, "pace": self._pace, "failure": self._failure}
        return {**playback, **self._exhibit.state(), "robots": robots}

    def _hear(self, data: str | bytes) -> None:
        message = messages.accepted(data)
        if isinstance(message, messages.Open):
            self._opening = message
        if message is not None:
            self._requests.put(partial(self._react, message))

    def _react(self, message: messages.Request) -> None:
        match message:
            case messages.Pause(on=on):
                self._paused, self._failure = on, None
            case messages.Pace(value=value):
                self._pace = min(max(value, SLOWEST), 1.0)
            case messages.Open() if message is not self._opening:
                return  # to open a run takes a second, and another one follows
            case _:
                self._exhibit.react(message)
                if isinstance(message, messages.Open):
                    self._failure = None
        self._show()

    def _greet(self, tab: ServerConnection) -> None:
        self._requests.put(partial(self._show, tab))

    def _tell(self, text: str) -> None:
        """Show an error in all browsers."""
        self._server.send(json.dumps({"type": "tell", "text": text}))


def files() -> dict[str, bytes]:
    """Return what the server serves, by path.

    Raises:
        MorlaxError: three.js is neither in the cache nor can it be downloaded.
    """
    found = page_files()
    found[""] = found.pop("index.html").replace(b'lang="en"', b'lang="en" data-engine="remote"')
    return found | {f"libraries/{name}": data for name, data in libraries.files("three").items()}
