"""A window that shows a robot in real time."""

import time
import warnings

import mujoco

from ..envs import MorlaxError


class Window:
    """MuJoCo's passive viewer, driven by the loop that moves the robot.

    Args:
        model: the robot's model.
        data: the state to show; change it in place between calls of `show`.
        dt: simulated seconds between two calls of `show`.

    Raises:
        MorlaxError: there is no screen.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, dt: float):
        _require_screen()
        import mujoco.viewer

        try:
            self._viewer = mujoco.viewer.launch_passive(
                model, data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:  # macOS opens windows only under mjpython
            raise MorlaxError(f"MuJoCo cannot open a window here: {error}.") from None
        self._dt, self._due = dt, time.monotonic()

    def show(self) -> None:
        """Show the current state of `data`, at least `dt` seconds after the previous call."""
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = max(self._due, time.monotonic()) + self._dt
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


def _require_screen() -> None:
    # Check first: MuJoCo's viewer would fail in its own thread while its caller waits forever.
    try:
        import glfw

        with warnings.catch_warnings(action="ignore"):
            has_screen = glfw.init()
    except ImportError:
        has_screen = False
    if not has_screen:
        raise MorlaxError(
            "render_mode 'human' opens a window, but there is no screen here: use 'rgb_array'."
        )
