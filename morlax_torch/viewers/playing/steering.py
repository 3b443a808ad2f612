"""Steer a robot by keys of MuJoCo's viewer and by a gamepad."""

import os
import struct
from pathlib import Path

import numpy as np

from ...envs import MorlaxError
from ...host.files import attempting
from .deployment import Export
from .policy import Policy
from .robot import Array

NOTCH = 0.1  # share of a range that a key changes the command by
UP, DOWN, LEFT, RIGHT, ENTER = 265, 264, 263, 262, 257  # of GLFW
MOVES = {  # keys that the viewer itself does not use: entry of the command, direction
    UP: (0, 1),
    DOWN: (0, -1),
    ord("7"): (1, 1),
    ord("8"): (1, -1),
    LEFT: (2, 1),
    RIGHT: (2, -1),
}
SLIDES = {ord("6"): -1, ord("9"): 1}
HELP = (
    "up, down: forward; left, right: turn; 7, 8: sideways; Enter: stop; 6, 9: slide the trade-off"
)
EVENT = struct.Struct("IhBB")  # of a joystick in Linux: ms, value, kind, number
BUTTON, AXIS = 1, 2
STICKS = {1: 0, 0: 1, 3: 2}  # axis of a gamepad: entry of the command
FULL = 32767  # of a stick's value


class Steering:
    """The command (3,) that a user holds, and the trade-off that he or she slides to.

    Trade-offs are the balanced one and, in turn, each objective alone.
    """

    def __init__(self, deployment: Export, policy: Policy):
        self._low, self._high = np.array(deployment.settings.limits).T
        self._policy, self._chosen = policy, 0
        m = len(policy.objectives)
        self._choices = [np.full(m, 1 / m), *np.eye(m)]
        self.command: Array = np.zeros(3)

    def press(self, key: int) -> None:
        """Follow a key of the viewer, by its code in GLFW."""
        if key in MOVES:
            entry, sign = MOVES[key]
            self._move(entry, self.command[entry] + sign * NOTCH * self._high[entry])
        elif key in SLIDES:
            self._slide(SLIDES[key])
        elif key == ENTER:
            self.command = np.zeros(3)

    def feel(self, event: bytes) -> None:
        """Follow an event of a gamepad: left stick to walk, right one to turn, any button."""
        _, value, kind, number = EVENT.unpack(event)
        if kind == AXIS and number in STICKS:
            entry, share = STICKS[number], -value / FULL
            limit = self._high[entry] if share > 0 else -self._low[entry]
            self._move(entry, share * limit)
        elif kind == BUTTON and value:
            self._slide(1)

    def words(self) -> tuple[str, str]:
        """Return the names and the values of what is steered, one per line."""
        weights = dict(zip(self._policy.objectives, self._policy.tradeoff, strict=True))
        values = dict(zip(("forward", "left", "turn"), self.command, strict=True))
        values |= weights if self._policy.slides else {}
        return "\n".join(values), "\n".join(f"{value:.2f}" for value in values.values())

    def _move(self, entry: int, value: float) -> None:
        command = self.command.copy()
        command[entry] = np.clip(value, self._low[entry], self._high[entry])
        self.command = command  # the viewer presses keys in a thread of its own

    def _slide(self, direction: int) -> None:
        self._chosen = (self._chosen + direction) % len(self._choices)
        self._policy.choose(self._choices[self._chosen])


class Gamepad:
    """A gamepad of Linux, such as /dev/input/js0.

    Raises:
        MorlaxError: it cannot be opened.
    """

    def __init__(self, path: Path):
        if not hasattr(os, "O_NONBLOCK"):
            raise MorlaxError("--gamepad needs Linux: leave it out and use the keys.")
        with attempting(f"use the gamepad {path}"):
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def events(self) -> list[bytes]:
        """Return the events since the last call, or raise MorlaxError if it is unplugged."""
        with attempting("read the gamepad"):
            try:
                found = os.read(self._file, 64 * EVENT.size)
            except BlockingIOError:
                return []
        whole = len(found) // EVENT.size * EVENT.size
        return [found[start : start + EVENT.size] for start in range(0, whole, EVENT.size)]
