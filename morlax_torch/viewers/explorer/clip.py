"""A recorded motion that repeats."""

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...envs import MorlaxError
from .behavior import Behavior


class Clip(Behavior):
    """A robot that repeats recorded positions.

    Args:
        model: the robot.
        qpos: (T, nq) positions, finite.
        dt: seconds between two of them.

    Raises:
        MorlaxError: the positions do not fit the model, or one is not finite.
    """

    def __init__(self, model: mujoco.MjModel, qpos: ArrayLike, dt: float):
        super().__init__(model, mujoco.MjData(model), dt)
        self._qpos = np.asarray(qpos, dtype=np.float64)
        if self._qpos.ndim != 2 or len(self._qpos) == 0 or self._qpos.shape[1] != model.nq:
            raise MorlaxError(
                f"a clip needs positions of shape (T, {model.nq}), not {self._qpos.shape}."
            )
        if not np.isfinite(self._qpos).all():
            raise MorlaxError("a clip needs finite positions.")
        self.reset()

    @property
    def robot(self) -> object:
        return self.model

    def step(self) -> None:
        self.steps = (self.steps + 1) % len(self._qpos)
        self._place()

    def reset(self) -> None:
        self.steps = 0
        self._place()

    def _place(self) -> None:
        self.data.qpos[:] = self._qpos[self.steps]
        mujoco.mj_kinematics(self.model, self.data)
