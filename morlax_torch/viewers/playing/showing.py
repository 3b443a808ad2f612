"""Show a played robot: live in MuJoCo's viewer, or in a film without a display."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...envs import MorlaxError
from ...host.phases import phase
from .deployment import Export
from .disturbances import Disturbances
from .episodes import Wishes, check_times, policy_of
from .robot import Robot
from .steering import Gamepad, Steering

SIZE = 480, 360  # pixels of a film
FASTEST = 30.0  # frames per second of a film


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

    A robot that falls starts again.

    Args:
        deployment: the export.
        disturbances: None for none.
        seconds: None for no limit.
        gamepad: device of a gamepad, beside the keys.
        seed: random seed of the disturbances.

    Returns:
        The number of falls.

    Raises:
        MorlaxError: the gamepad or the window cannot be opened.
    """
    from mujoco import viewer  # loads a library of windows

    robot, policy, falls = Robot(deployment, disturbances, seed), policy_of(deployment), 0
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
                made = robot.step(policy.act(robot.observe(steering.command)))
                if made.fallen:
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

    Raises:
        MorlaxError: no OpenGL, no ffmpeg, or `output` cannot be written.
    """
    from ..filming.recording import ENDINGS, write_video

    check_times(deployment, seconds)
    if output.suffix.lower() not in ENDINGS:
        raise MorlaxError(f"{output} must end in {' or '.join(ENDINGS)}.")
    robot = Robot(deployment, disturbances, seed)
    robot.model.light_castshadow[:] = 0  # shadows and reflections of fine meshes take a CPU a
    robot.model.mat_reflectance[:] = 0  # second per frame
    every = max(1, round(1 / (robot.dt * FASTEST)))
    falls: list[float] = []
    frames = _frames(robot, deployment, round(seconds / robot.dt), every, seed, falls)
    write_video(output, frames, 1 / (robot.dt * every))
    return len(falls)


def _frames(
    robot: Robot,
    deployment: Export,
    steps: int,
    every: int,
    seed: int,
    falls: list[float],
) -> Iterator[NDArray[np.uint8]]:
    """Render every so many control steps (H, W, 3), and append the time of each fall."""
    from ..camera import FollowingCamera
    from ..filming.rendering import Scene

    policy, wishes = policy_of(deployment), Wishes(deployment, np.random.default_rng(seed))
    camera = FollowingCamera(robot.model, SIZE[0] / SIZE[1])
    camera.restart(robot.data)
    with Scene(robot.model, *SIZE) as scene:
        for step in range(steps):
            phase("filming", step / steps)
            if step % every == 0:
                yield scene.draw(robot.data, camera.camera)
            command = wishes.command(step * robot.dt, policy)
            if robot.step(policy.act(robot.observe(command))).fallen:
                falls.append(step * robot.dt)
                robot.reset()
            camera.follow(robot.data, robot.dt)
