"""Play an export: in many episodes, in MuJoCo's viewer, or in a film without a display."""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...host.phases import phase
from .deployment import Export
from .robot import Disturbances, Robot
from .steering import Gamepad, Policy, Steering, Wishes

SIZE = 480, 360  # pixels of a film
FASTEST = 30.0  # frames per second of a film


class Episode(NamedTuple):
    """The outcome of an episode; means are over its control steps."""

    falls: float
    seconds: float  # until the fall, if there was one
    error: float  # m/s, between commanded and actual horizontal velocity
    power: float  # W, positive mechanical power of all joints
    speed: float  # m/s, horizontal
    weight: float  # N, of the robot

    @property
    def transport(self) -> float:
        """The cost of transport: power / (weight * speed)."""
        return self.power / max(self.weight * self.speed, 1e-9)


def run(
    deployment: Export,
    disturbances: Disturbances | None,
    episodes: int,
    seconds: float = 30.0,
    seed: int = 0,
) -> list[Episode]:
    """Run episodes under random commands and trade-offs, which end with a fall."""
    steps = _steps(deployment, seconds)
    if episodes < 1:
        raise MorlaxError(f"--episodes must be at least 1, not {episodes}.")
    policy, rows = Policy(deployment), []
    for number in range(episodes):
        phase("playing", number / episodes)
        draws, wishes = np.random.SeedSequence([seed, number]).spawn(2)
        robot = Robot(deployment, disturbances, draws)
        rows.append(_episode(robot, policy, deployment, np.random.default_rng(wishes), steps))
    return rows


def _steps(deployment: Export, seconds: float) -> int:
    step = deployment.settings.step_dt
    if not step <= seconds <= 1e6:
        raise MorlaxError(f"--seconds must be from {step:g} to 1000000, not {seconds:g}.")
    return round(seconds / step)


def _episode(
    robot: Robot, policy: Policy, deployment: Export, rng: np.random.Generator, steps: int
) -> Episode:
    wishes, fallen = Wishes(deployment, policy, rng), False
    rows = []  # error, power and speed of each step
    for step in range(steps):
        command = wishes.command(step * robot.dt)
        made = robot.step(policy.act(robot.observe(command)))
        if fallen := made.fallen:
            break
        error = np.linalg.norm(command[:2] - made.velocity[:2])
        rows.append((error, made.power, np.linalg.norm(made.velocity[:2])))
    error, power, speed = np.mean(rows, axis=0).tolist() if rows else [np.nan] * 3
    seconds = (len(rows) + fallen) * robot.dt
    return Episode(float(fallen), seconds, error, power, speed, robot.weight())


def summary(episodes: Sequence[Episode]) -> Episode:
    """Return the number of falls, and means weighted by time."""
    times = np.array([episode.seconds for episode in episodes])
    means = np.average(np.array(episodes), axis=0, weights=times)
    return Episode(
        sum(episode.falls for episode in episodes), float(times.sum()), *means[2:].tolist()
    )


def has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in names)


def show(
    deployment: Export,
    disturbances: Disturbances | None,
    seconds: float | None = None,
    gamepad: Path | None = None,
    seed: int = 0,
) -> int:
    """Run the robot in real time in a window that steers it, until the window is closed.

    A robot that falls starts again. `seconds` is None for no limit; `gamepad` is a device that
    steers beside the keys.
    Returns the number of falls.
    """
    from mujoco import viewer  # loads a library of windows

    robot, policy, falls = Robot(deployment, disturbances, seed), Policy(deployment), 0
    steering = Steering(deployment, policy)
    pad = None if gamepad is None else Gamepad(gamepad)
    try:
        window = viewer.launch_passive(
            robot.model, robot.data, key_callback=steering.press, show_left_ui=False
        )
    except RuntimeError as error:  # on macOS, only mjpython may open a window
        raise MorlaxError(f"cannot open a window: {' '.join(str(error).split())}") from None
    window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
    window.cam.trackbodyid = robot.base
    began, steps = time.perf_counter(), 0
    with window:
        while window.is_running() and (seconds is None or steps * robot.dt < seconds):
            for event in pad.events() if pad else ():
                steering.feel(event)
            with window.lock():
                if robot.step(policy.act(robot.observe(steering.command))).fallen:
                    falls += 1
                    robot.reset()
            window.set_texts((None, mujoco.mjtGridPos.mjGRID_TOPLEFT, *steering.words()))
            window.sync()
            steps += 1
            late = began + steps * robot.dt - time.perf_counter()
            if late > 0:
                time.sleep(late)
            else:  # do not hurry to catch up
                began -= late
    return falls


def film(
    deployment: Export,
    disturbances: Disturbances | None,
    output: Path,
    seconds: float,
    seed: int = 0,
) -> int:
    """Write a film (.mp4, .gif) of the robot under random commands and trade-offs.

    Returns the number of falls.
    """
    from ..camera import FollowingCamera
    from ..filming.recording import ENDINGS, write_video
    from ..filming.rendering import Scene

    steps, falls = _steps(deployment, seconds), 0
    if output.suffix.lower() not in ENDINGS:
        raise MorlaxError(f"{output} must end in {' or '.join(ENDINGS)}.")
    robot, policy = Robot(deployment, disturbances, seed), Policy(deployment)
    robot.model.light_castshadow[:] = 0  # shadows and reflections of fine meshes take a CPU a
    robot.model.mat_reflectance[:] = 0  # second per frame
    wishes = Wishes(deployment, policy, np.random.default_rng(seed))
    stride = max(1, round(1 / (robot.dt * FASTEST)))

    def frames() -> Iterator[NDArray[np.uint8]]:
        nonlocal falls
        camera = FollowingCamera(robot.model, SIZE[0] / SIZE[1])
        camera.restart(robot.data)
        with Scene(robot.model, *SIZE) as scene:
            for step in range(steps):
                phase("filming", step / steps)
                if step % stride == 0:
                    yield scene.draw(robot.data, camera.camera)
                command = wishes.command(step * robot.dt)
                if robot.step(policy.act(robot.observe(command))).fallen:
                    falls += 1
                    robot.reset()
                camera.follow(robot.data, robot.dt)

    write_video(output, frames(), 1 / (robot.dt * stride))
    return falls
