"""Pictures of a robot in given states, and a window that shows it in real time."""

import time
import warnings

import mujoco
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..envs import MorlaxError, Robot
from ..viewers.camera import FollowingCamera
from ..viewers.filming.rendering import Scene


class Pictures:
    """Draws a robot. It opens OpenGL with the first picture."""

    def __init__(self, robot: Robot, width: int, height: int):
        model = robot.physics.model
        self.data = mujoco.MjData(model)
        self._model, self._size = model, (width, height)
        self._scene: Scene | None = None
        # all pictures share the camera's distance, which is chosen by the model's own pose
        mujoco.mj_forward(model, self.data)
        self._camera = FollowingCamera(model, width / height, base=robot.base)
        self._camera.restart(self.data)

    def pose(self, qpos: Tensor, qvel: Tensor) -> mujoco.MjData:
        """Put the robot into a state, qpos (nq,) and qvel (nv,); returns `data`."""
        self.data.qpos[:] = qpos.cpu().numpy()
        self.data.qvel[:] = qvel.cpu().numpy()
        mujoco.mj_forward(self._model, self.data)
        return self.data

    def draw(self, qpos: Tensor, qvel: Tensor) -> NDArray[np.uint8]:
        """Return a picture of the robot in a state, (height, width, 3) RGB.

        Raises:
            MorlaxError: the size is out of range, or OpenGL is not available.
        """
        if self._scene is None:
            self._scene = Scene(self._model, *self._size)
        data, camera = self.pose(qpos, qvel), self._camera.camera
        camera.lookat[:] = data.subtree_com[self._camera.base]
        return self._scene.draw(data, camera)

    def close(self) -> None:
        """Free the renderer."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None


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
    import glfw

    with warnings.catch_warnings(action="ignore"):
        has_screen = glfw.init()
    if not has_screen:
        raise MorlaxError(
            "render_mode 'human' opens a window, but there is no screen here: use 'rgb_array'."
        )
