"""A policy with its trade-off, and who steers it: chance, keys of MuJoCo's viewer, a gamepad."""

import os
import struct
from pathlib import Path

import numpy as np

from ...envs import MorlaxError
from ...envs.errors import installation
from ...host.files import attempting, read
from .deployment import Export
from .robot import Array

PERIODS = 3.0, 8.0  # s for which a command or a trade-off is wished for
STANDING = 0.1  # share of the commands that are to stand still
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


class Policy:
    """An ONNX policy; `tradeoff` (m,) slides towards the `target` (m,) by at most `slew` per s.

    It stays as it is where the export has a fixed trade-off (`slides` is false).
    """

    def __init__(self, deployment: Export):
        try:
            import onnxruntime
        except ImportError:
            raise MorlaxError(
                f"play needs onnxruntime, which is not installed: {installation('onnx')}."
            ) from None
        file, options = deployment.policy, onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # the network is small
        try:
            self._session = onnxruntime.InferenceSession(read(file, "policy"), options)
        except MorlaxError:
            raise
        except Exception as error:  # its own classes, which have no common base but this
            reason = " ".join(str(error).split())
            raise MorlaxError(f"onnxruntime cannot load {file}: {reason}.") from None
        self.objectives = tuple(deployment.settings.objectives)
        self.slides = "tradeoff" in {value.name for value in self._session.get_inputs()}
        slew = deployment.settings.slew or np.inf
        self._most = slew * deployment.settings.step_dt  # per control step
        self.tradeoff = self.target = np.full(len(self.objectives), 1 / len(self.objectives))

    def choose(self, target: Array, at_once: bool = False) -> None:
        """Slide towards a trade-off (m,) of weights that sum to one, or begin with it."""
        self.target = np.asarray(target, float)
        if at_once:
            self.tradeoff = self.target

    def act(self, observation: Array) -> Array:
        """Return the action (A,) for an observation (O,), one control step later in the slide."""
        way = self.target - self.tradeoff
        farthest = np.abs(way).max()
        self.tradeoff = self.tradeoff + way * min(1.0, self._most / max(farthest, 1e-12))
        inputs = {"observation": observation[None].astype(np.float32)}
        if self.slides:
            inputs["tradeoff"] = self.tradeoff.astype(np.float32)
        (actions,) = self._session.run(["action"], inputs)
        return np.asarray(actions, float)[0]


class Wishes:
    """Draws commands within the ranges and trade-offs on the simplex, each for some seconds."""

    def __init__(self, deployment: Export, policy: Policy, rng: np.random.Generator):
        self._low, self._high = np.array(deployment.settings.limits).T
        self._policy, self._rng = policy, rng
        self._until = [0.0, 0.0]  # s: of the command and the trade-off
        self._command = np.zeros(3)

    def command(self, seconds: float) -> Array:
        """Return the command (3,) at this time, and tell the policy its trade-off."""
        if seconds >= self._until[0]:
            self._until[0] = seconds + self._rng.uniform(*PERIODS)
            walks = self._rng.random() >= STANDING
            self._command = walks * self._rng.uniform(self._low, self._high)
        if seconds >= self._until[1]:
            self._until[1] = seconds + self._rng.uniform(*PERIODS)
            target = self._rng.dirichlet(np.ones(len(self._policy.objectives)))
            self._policy.choose(target, at_once=seconds == 0)
        return self._command


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
    """A gamepad of Linux, such as /dev/input/js0; raises MorlaxError if it cannot be opened."""

    def __init__(self, path: Path):
        if not hasattr(os, "O_NONBLOCK"):
            raise MorlaxError("--gamepad needs Linux: leave it out and use the keys.")
        with attempting(f"use the gamepad {path}"):
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def events(self) -> list[bytes]:
        """Return the events since the last call, or raise MorlaxError if it is unplugged."""
        with attempting("read the gamepad"):
            try:
                data = os.read(self._file, 64 * EVENT.size)
            except BlockingIOError:
                return []
        complete = len(data) // EVENT.size * EVENT.size
        return [data[start : start + EVENT.size] for start in range(0, complete, EVENT.size)]
