"""A window that shows a robot in real time."""

import time
import warnings

import mujoco

from ..envs import MorlaxError


class Window:
    """MuJoCo's own viewer, beside a loop that moves the robot.

    Args:
        model: of the robot.
        data: that `show` shows.
        dt: seconds from one `show` to the next, of the robot's time.

    Raises:
        MorlaxError: there is no screen.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, dt: float):
        _need_a_screen()
        import mujoco.viewer

        try:
            self._viewer = mujoco.viewer.launch_passive(
                model, data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:  # macOS wants its own interpreter for windows
            raise MorlaxError(f"no window can be opened here: {error}.") from None
        self._dt, self._due = dt, time.monotonic()

    def show(self) -> None:
        """Show the robot as it stands in `data`, no sooner than dt after the last time."""
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due, time.monotonic()) + self._dt
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


def _need_a_screen() -> None:
    # Asked first, because MuJoCo's viewer fails in a thread of its own, and its caller waits on.
    try:
        import glfw

        with warnings.catch_warnings(action="ignore"):
            there = glfw.init()
    except ImportError:
        there = False
    if not there:
        raise MorlaxError(
            "render_mode 'human' opens a window, and there is no screen here: use 'rgb_array'."
        )
