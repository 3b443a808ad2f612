"""The page: a server, the robots that it shows, and the loop that runs both."""

import json
import logging
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial, reduce
from operator import or_
from queue import Empty, Queue
from typing import Any, Literal

from pydantic import ConfigDict, NonNegativeInt, TypeAdapter, ValidationError, create_model

from ...envs.errors import MorlaxError, words
from .. import libraries
from ..describing import model_bytes
from .exhibits import Request, RunExhibit
from .server import Server, ServerConnection
from .session import MAX_LAG, MODEL, frame_bytes

FRAME = 1 / 40  # s between frames
TELL = 1 / 10  # s between messages about anything but poses
SLOWEST = 0.05  # playback speed
_log = logging.getLogger(__name__)

ACTS: dict[str, dict[str, Any]] = {  # what browsers may ask for; anything else is ignored
    # the selected robot's trade-off, which is scaled to sum to one
    "steer": {"weights": list[float]},
    # numbers of all robots' command and design parameters of their body, clamped to their limits
    "tell": {"index": NonNegativeInt, "value": float},
    "nudge": {"index": NonNegativeInt, "change": float},
    "reshape": {"index": NonNegativeInt, "value": float},
    "pause": {"on": bool},
    "pace": {"value": float},  # playback speed; 1 is real time
    "press": {"name": str},  # a button that `RunExhibit.react` knows
    "select": {"robot": NonNegativeInt},  # steer another robot
    "open": {"run": str, "checkpoint": str | None},  # no checkpoint means the best
    # returns of objectives, then quantities; the level is clamped to the front's range
    "require": {"index": NonNegativeInt, "level": float | None},
    "maximize": {"index": NonNegativeInt},
    "answer": {"preferred": Literal[0, 1]},  # A or B
    "bookmark": {"name": str},  # of the selected robot's trade-off
    "rename": {"name": str, "new": str},  # a bookmark; an empty new name removes it
}
_STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
_model: Any = create_model  # a type checker cannot follow fields that a table has
_MODELS = [
    _model(act, __config__=_STRICT, act=(Literal[act], ...), **fields)
    for act, fields in ACTS.items()
]
_READER: TypeAdapter[Any] = TypeAdapter(reduce(or_, _MODELS))


class Page:
    """A server and the robots that it shows; `serve` runs both.

    Only the thread of `serve` uses the robots: requests of browsers and other threads are queued,
    so that nothing interrupts a step. A step that fails also pauses the robots, and browsers that
    connect later are told why. `address`, which a browser must open, contains a secret token.

    `queue` is that of the exhibit's calls. The port may be the next free one. Raises MorlaxError if
    three.js cannot be downloaded or the address cannot be listened on.
    """

    def __init__(self, exhibit: RunExhibit, queue: Queue, host: str, port: int):
        self._exhibit, self._queue = exhibit, queue
        self._opening: Request = {}  # the latest request to open a run
        self._paused, self._pace = False, 1.0
        self._failure: str | None = None  # why the robots paused by themselves
        self._robot: object = None  # that browsers know
        self._about, self._model = "", b""  # messages about it
        self._drawn: object = None  # its model, which a new body replaces
        self._state: dict[str, Any] = {}  # that they know
        self._server = Server(files(), host, port, self._hear)
        self.address = self._server.address

    def serve(self, ended: Callable[[], bool]) -> None:
        """Move the robots in real time for browsers; disconnect them once `ended` returns true."""
        frame = shown = 0.0
        while not ended():
            moves = self._server.tabs and not self._paused
            now, pace = time.perf_counter(), self._pace if moves else 0.0
            if failure := self._attempt(partial(self._advance, now, pace)):
                self._paused, self._failure = True, failure
            if now >= shown:
                shown = now + TELL
                self._show()
            if now >= frame:
                frame = now + FRAME
                poses = frame_bytes(self._exhibit.robots)
                if poses is not None:
                    self._server.send(poses)
            waits = [robot.until_next(pace) for robot in self._exhibit.robots]
            wait = min(*waits, MAX_LAG, frame - time.perf_counter())
            for action in drained(self._queue, max(wait, 0.0)):
                self._attempt(action)
                shown = 0.0  # before other robots' poses are sent, browsers must know the robots
        self._server.stop()

    def _advance(self, now: float, pace: float) -> None:
        for robot in self._exhibit.robots:
            robot.advance(now, pace)

    def _hear(self, tab: ServerConnection, message: str | bytes | None) -> None:
        """Queue a browser's request, if it is one of `ACTS`; called in the server's thread."""
        if message is None:
            self._queue.put(partial(self._show, tab))
            return
        try:
            request = _READER.validate_json(message).model_dump()
        except (ValidationError, RecursionError):
            return
        if request["act"] == "open":
            self._opening = request
        self._queue.put(partial(self._react, request))

    def _show(self, to: ServerConnection | None = None) -> None:
        """Send what has changed to all browsers, or everything to one."""
        first = self._exhibit.robots[0]
        if self._robot is not first.opened:
            self._robot, self._drawn = first.opened, None
            self._about = json.dumps({"type": "run", "about": first.about()})
            self._server.send(self._about)
        model = first.model
        if self._drawn is not model:
            self._drawn, self._model = model, MODEL + model_bytes(model)
            self._server.send(self._model)
        state = {
            "paused": self._paused,
            "pace": self._pace,
            "failure": self._failure,
            **self._exhibit.state(),
            "robots": [robot.told() for robot in self._exhibit.robots],
        }
        if to is not None:
            for message in (self._about, self._model, json.dumps({"type": "state", **state})):
                self._server.send(message, to)
        news = {k: v for k, v in state.items() if k not in self._state or self._state[k] != v}
        self._state = state
        if news:
            self._server.send(json.dumps({"type": "state", **news}))

    def _react(self, request: Request) -> None:
        match request:
            # to open a run takes a second; it is left out if another one follows
            case {"act": "open"} if request is not self._opening:
                return
            case {"act": "pause", "on": on}:
                self._paused, self._failure = on, None
            case {"act": "pace", "value": value}:
                self._pace = min(max(value, SLOWEST), 1.0)
            case _:
                self._exhibit.react(request)
                if request["act"] == "open":
                    self._failure = None

    def _attempt(self, action: Callable[[], object]) -> str | None:
        """Run `action`; if it fails, show the reason in all browsers and return it."""
        try:
            action()
        except MorlaxError as error:
            text = str(error)
        except Exception as error:  # in the robot's own code, for example
            _log.exception("The page goes on after this error:")
            text = words(error)
        else:
            return None
        self._server.send(json.dumps({"type": "tell", "text": text}))
        return text


def drained(queue: Queue, seconds: float) -> list:
    """Wait up to `seconds` until something is queued, and return everything that is by then."""
    with suppress(Empty):
        first = queue.get(timeout=seconds)
        return [first, *(queue.get_nowait() for _ in range(queue.qsize()))]
    return []


def files() -> dict[str, bytes]:
    contents = libraries.page_files("three")
    index = contents.pop("index.html")
    contents[""] = index.replace(b'lang="en"', b'lang="en" data-engine="remote"')
    return contents
