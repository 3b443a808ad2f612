"""MuJoCo's window."""

import os
import sys
import warnings
from typing import Any

import mujoco

from ..envs.errors import MorlaxError


def has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform != "linux" or any(os.environ.get(name) for name in names)


def open_window(model: mujoco.MjModel, data: mujoco.MjData, remedy: str, **options: Any) -> Any:
    """Open MuJoCo's passive viewer, which shows what its caller changes in `data`.

    Raises:
        MorlaxError: there is no screen, with the `remedy`.
    """
    import glfw
    import mujoco.viewer

    # check first: MuJoCo's viewer would fail in its own thread while its caller waits forever
    with warnings.catch_warnings(action="ignore"):
        has_screen = glfw.init()
    if not has_screen:
        raise MorlaxError(f"there is no screen here: {remedy}.")
    try:
        return mujoco.viewer.launch_passive(model, data, show_left_ui=False, **options)
    except RuntimeError as error:  # macOS opens windows only under mjpython
        raise MorlaxError(f"MuJoCo cannot open a window here: {error}.") from None
