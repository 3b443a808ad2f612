"""Pictures of a robot in given states."""

import mujoco
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..viewers.camera import FILL, View
from ..viewers.filming.rendering import Scene


class Pictures:
    """Draws a robot. It opens OpenGL with the first picture.

    Args:
        model: the robot's model.
        width: of a picture, in pixels.
        height: of a picture, in pixels.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        self.data = mujoco.MjData(model)
        self._model, self._size = model, (width, height)
        self._scene: Scene | None = None
        self._view, self._camera = View(model, width / height), mujoco.MjvCamera()
        self._fit()

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
        data, view = self.pose(qpos, qvel), self._view
        view.place(self._camera, view.mass(data) + self._offset, self._distance)
        return self._scene.draw(data, self._camera)

    def _fit(self) -> None:
        """Choose the camera's distance, which all pictures share, by the model's own pose."""
        mujoco.mj_forward(self._model, self.data)
        points = self._view.points(self.data)
        center = self._view.middle(points)
        self._offset = center - self._view.mass(self.data)
        self._distance = self._view.distance(points, center, FILL)

    def close(self) -> None:
        """Free the renderer."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None
