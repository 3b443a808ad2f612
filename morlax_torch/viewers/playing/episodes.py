"""Play an export: in many episodes, in a window that keys or a gamepad steer, or in a film."""

import os
import struct
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import count, islice
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs.errors import MorlaxError, installation
from ...exports.deployment import SETTINGS
from ...host.files import attempting, read
from ...host.phases import phase
from ..window import open_window
from .following import robot_for
from .robot import Array, Export, Robot

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
SLIDING = "6, 9: slide the trade-off"
HELP = f"up, down: forward; left, right: turn; 7, 8: sideways; Enter: stop; {SLIDING}"
EVENT = struct.Struct("IhBB")  # of a joystick in Linux: ms, value, kind, number
BUTTON, AXIS = 1, 2
STICKS = {1: 0, 0: 1, 3: 2}  # axis of a gamepad: entry of the command
FULL = 32767  # of a stick's value
SIZE = 480, 360  # pixels of a film
FASTEST = 30.0  # frames per second of a film


class Policy:
    """An ONNX policy; `tradeoff` (m,) slides towards the `target` (m,) by at most `slew` per s.

    With a fixed trade-off (`slides` is false), it stays. The target follows the `schedule`, if any.
    """

    def __init__(self, deployment: Export):
        try:
            import onnxruntime
        except ImportError:
            raise MorlaxError(f"play needs onnxruntime: {installation('onnx')}.") from None
        self._file, options = deployment.policy, onnxruntime.SessionOptions()
        content = read(self._file, "policy")
        options.intra_op_num_threads = 1  # the network is small
        # errors of its own classes, which have no common base but this
        with attempting(f"load {deployment.policy}", Exception):
            self._session = onnxruntime.InferenceSession(content, options)
        self.objectives = tuple(deployment.settings.objectives)
        self._actions = len(deployment.settings.driven)
        self.slides = "tradeoff" in {value.name for value in self._session.get_inputs()}
        if (schedule := deployment.tradeoff) and not self.slides:
            raise MorlaxError(f"{deployment.policy} has a fixed trade-off: leave --tradeoff out.")
        self.schedule = schedule
        # largest change per control step
        self._most = (deployment.settings.slew or np.inf) * deployment.settings.step_dt
        self.tradeoff = self.target = np.full(len(self.objectives), 1 / len(self.objectives))

    def choose(self, target: Array, at_once: bool = False) -> None:
        """Slide towards a trade-off (m,) of weights that sum to one, or begin with it."""
        self.target = np.asarray(target, float)
        if at_once:
            self.tradeoff = self.target

    def act(self, observation: Array, seconds: float = 0.0) -> Array:
        """Slide by a control step; return the action (A,), `seconds` after a motion began."""
        if schedule := self.schedule:
            self.choose(schedule.at(seconds), at_once=seconds == 0)
        way = self.target - self.tradeoff
        farthest = np.abs(way).max()
        self.tradeoff = self.tradeoff + way * min(1.0, self._most / max(farthest, 1e-12))
        inputs = {"observation": observation[None].astype(np.float32)}
        if self.slides:
            inputs["tradeoff"] = self.tradeoff.astype(np.float32)
        with attempting(f"run {self._file} by the {SETTINGS} beside it", Exception):
            (actions,) = self._session.run(["action"], inputs)
            return np.asarray(actions, float).reshape(self._actions)

    def drive(self, robot: Robot, command: Array) -> bool:
        """Take a control step, and return whether the robot fell; it starts again at an end."""
        step = robot.step(self.act(robot.observe(command), robot.seconds))
        if step.fallen or step.over:
            robot.reset()
        return step.fallen


def wishes(deployment: Export, policy: Policy, rng: np.random.Generator) -> Iterator[Array]:
    """Yield a random command (3,) per control step, and tell the policy random trade-offs."""
    low, high = np.array(deployment.settings.limits).T
    next_command = next_tradeoff = 0.0  # s
    command = np.zeros(3)
    for step in count():
        seconds = step * deployment.settings.step_dt
        if seconds >= next_command:
            next_command = seconds + rng.uniform(*PERIODS)
            walks = rng.random() >= STANDING
            command = walks * rng.uniform(low, high)
        if seconds >= next_tradeoff:
            next_tradeoff = seconds + rng.uniform(*PERIODS)
            policy.choose(rng.dirichlet(np.ones(len(policy.objectives))), at_once=step == 0)
        yield command


class Steering:
    """The command (3,) that a user holds, and the trade-off: balanced or one objective alone."""

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

    def feel(self, value: int, kind: int, number: int) -> None:
        """Follow an event of a gamepad: left stick to walk, right one to turn, any button."""
        if kind == AXIS and number in STICKS:
            entry, share = STICKS[number], -value / FULL
            limit = self._high[entry] if share > 0 else -self._low[entry]
            self._move(entry, share * limit)
        elif kind == BUTTON and value:
            self._slide(1)

    def words(self) -> tuple[str, str]:
        """Return the names and the values of what is steered, one per line."""
        weights = dict(zip(self._policy.objectives, self._policy.tradeoff, strict=True))
        names = ("forward", "left", "turn") if self._high.any() else ()  # a motion is not steered
        values = dict(zip(names, self.command, strict=False))
        values |= weights if self._policy.slides else {}
        return "\n".join(values), "\n".join(f"{value:.2f}" for value in values.values())

    def _move(self, entry: int, value: float) -> None:
        command = self.command.copy()
        command[entry] = np.clip(value, self._low[entry], self._high[entry])
        self.command = command  # the viewer presses keys in a thread of its own

    def _slide(self, direction: int) -> None:
        self._chosen = (self._chosen + direction) % len(self._choices)
        self._policy.schedule = None
        self._policy.choose(self._choices[self._chosen])


class Gamepad:
    """A gamepad of Linux, such as /dev/input/js0; raises MorlaxError if it cannot be used."""

    def __init__(self, path: Path):
        with attempting(f"use the gamepad {path}"):
            self._file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))

    def events(self) -> list[tuple[int, ...]]:
        """Return value, kind and number of the events since the last call."""
        data = b""
        with attempting("read the gamepad"), suppress(BlockingIOError):
            data = os.read(self._file, 64 * EVENT.size)  # the driver writes whole events
        return [event[1:] for event in EVENT.iter_unpack(data)]


class Episode(NamedTuple):
    """The outcome of an episode; means are over its control steps."""

    falls: float
    seconds: float  # until the fall, if there was one
    error: float  # m/s, between commanded and actual horizontal velocity, or mm from a motion
    power: float  # W, positive mechanical power of all joints
    speed: float  # m/s, horizontal
    weight: float  # N, of the robot

    @property
    def transport(self) -> float:
        """The cost of transport: power / (weight * speed)."""
        return self.power / max(self.weight * self.speed, 1e-9)


def run(deployment: Export, episodes: int, seconds: float = 30.0, seed: int = 0) -> list[Episode]:
    """Run episodes under random commands and trade-offs, which end with a fall or the motion."""
    steps = _steps(deployment, seconds)
    if episodes < 1:
        raise MorlaxError(f"--episodes must be at least 1, not {episodes}.")
    policy, rows = Policy(deployment), []
    for number in range(episodes):
        phase("playing", number / episodes)
        draws, rng = np.random.SeedSequence([seed, number]).spawn(2)
        robot = robot_for(deployment, draws)
        commands = wishes(deployment, policy, np.random.default_rng(rng))
        rows.append(_episode(robot, policy, islice(commands, steps)))
    return rows


def _steps(deployment: Export, seconds: float) -> int:
    step = deployment.settings.step_dt
    if not step <= seconds <= 1e6:
        raise MorlaxError(f"--seconds must be from {step:g} to 1000000, not {seconds:g}.")
    return round(seconds / step)


def _episode(robot: Robot, policy: Policy, commands: Iterable[Array]) -> Episode:
    fallen, rows = False, []  # error, power and speed of each step
    for command in commands:
        step = robot.step(policy.act(robot.observe(command), robot.seconds))
        if fallen := step.fallen:
            break
        rows.append((step.error, step.power, np.linalg.norm(step.velocity[:2])))
        if step.over:
            break
    error, power, speed = np.mean(rows, axis=0).tolist() if rows else [np.nan] * 3
    seconds = (len(rows) + fallen) * robot.dt
    return Episode(float(fallen), seconds, error, power, speed, robot.weight())


def summary(episodes: Sequence[Episode]) -> Episode:
    """Return the number of falls, and means weighted by time."""
    rows = np.array(episodes)
    lasted = ~np.isnan(rows[:, 2])  # an episode that ends with its first control step has no means
    walked = rows[lasted] if lasted.any() else rows
    means = np.average(walked, axis=0, weights=walked[:, 1])
    return Episode(*rows[:, :2].sum(0).tolist(), *means[2:].tolist())


def show(
    deployment: Export, seconds: float | None = None, gamepad: Path | None = None, seed: int = 0
) -> int:
    """Run the robot in real time in a window that steers it, and return the number of falls.

    It ends after `seconds`, if limited, or with the window. `gamepad` is a device that steers too.
    """
    robot, policy, falls = robot_for(deployment, seed), Policy(deployment), 0
    steering = Steering(deployment, policy)
    pad = None if gamepad is None else Gamepad(gamepad)
    remedy = "write a film with --output film.mp4"
    window = open_window(robot.model, robot.data, remedy, key_callback=steering.press)
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = robot.base
    began, steps = time.perf_counter(), 0
    with window:
        while window.is_running() and (seconds is None or steps * robot.dt < seconds):
            for event in pad.events() if pad else ():
                steering.feel(*event)
            with window.lock():
                falls += policy.drive(robot, steering.command)
            window.set_texts((None, mujoco.mjtGridPos.mjGRID_TOPLEFT, *steering.words()))
            window.sync()
            steps += 1
            late = began + steps * robot.dt - time.perf_counter()
            if late > 0:
                time.sleep(late)
            else:  # do not hurry to catch up
                began -= late
    return falls


def film(deployment: Export, output: Path, seconds: float, seed: int = 0) -> int:
    """Film the robot under random commands and trade-offs (.mp4, .gif); return the falls."""
    from ..camera import FollowingCamera
    from ..filming.recording import ENDINGS, write_video
    from ..filming.rendering import Scene

    steps, falls = _steps(deployment, seconds), 0
    if output.suffix.lower() not in ENDINGS:
        raise MorlaxError(f"{output} must end in {' or '.join(ENDINGS)}.")
    robot, policy = robot_for(deployment, seed), Policy(deployment)
    robot.model.light_castshadow[:] = 0  # shadows and reflections of fine meshes take a CPU a
    robot.model.mat_reflectance[:] = 0  # second per frame
    commands = wishes(deployment, policy, np.random.default_rng(seed))
    stride = max(1, round(1 / (robot.dt * FASTEST)))

    def frames() -> Iterator[NDArray[np.uint8]]:
        nonlocal falls
        camera = FollowingCamera(robot.model, SIZE[0] / SIZE[1], robot.base)
        camera.restart(robot.data)
        with Scene(robot.model, *SIZE) as scene:
            for step, command in enumerate(islice(commands, steps)):
                phase("filming", step / steps)
                if step % stride == 0:
                    yield scene.draw(robot.data, camera.camera, robot.ghost())
                falls += policy.drive(robot, command)
                camera.follow(robot.data, robot.dt)

    write_video(output, frames(), 1 / (robot.dt * stride))
    return falls
