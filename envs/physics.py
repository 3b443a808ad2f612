"""What an environment may ask of a simulator."""

from abc import ABC, abstractmethod

import mujoco
import numpy as np
import torch
from torch import Tensor

from .errors import unknown


class Physics(ABC):
    """N copies of one MuJoCo model on one device, advanced together, seen as torch tensors.

    The tensors are views of the simulator's own memory: reading one copies nothing and writing
    one in place moves the robots. Never rebind them (`physics.qpos = ...` would silently detach
    from the simulator). `sensors` describes the state that *entered* the last physics step, as
    after C MuJoCo's `mj_step`; after a reset it holds what the new state would read.
    """

    name: str  # of the simulator
    model: mujoco.MjModel
    num_worlds: int
    device: torch.device
    qpos: Tensor  # (N, nq) metres, radians
    qvel: Tensor  # (N, nv) m/s, rad/s
    ctrl: Tensor  # (N, nu)
    warmstart: Tensor  # (N, nv) where the constraint solver starts its next search
    sensors: Tensor  # (N, nsensordata)
    leftovers: tuple[Tensor, ...] = ()  # (N, ...) what else of the last step the next one reads

    @abstractmethod
    def step(self) -> None:
        """Advance every world by one control step, holding `ctrl`."""

    @abstractmethod
    def vary(self, fields: dict[str, np.ndarray]) -> None:
        """Give each world a model of its own, that differs in `fields` (N, ...), by name.

        The constants that MuJoCo derives from them follow. Worlds keep their state.

        Raises:
            MorlaxError: the simulator shares such a field between worlds.
        """

    @abstractmethod
    def overflow(self) -> Tensor:
        """(N,) int32, non-zero where contacts or constraints no longer fitted their buffers."""

    @abstractmethod
    def remedy(self, bits: int) -> str:
        """What to do about the union `bits` of what `overflow` returned, in words."""

    def sensor(self, name: str) -> Tensor:
        """A view (N, dim) of one sensor's readings.

        Raises:
            MorlaxError: the model has no such sensor.
        """
        known = [self.model.sensor(index).name for index in range(self.model.nsensor)]
        if name not in known:
            raise unknown("sensor", name, known)
        sensor = self.model.sensor(name)
        return self.sensors[:, sensor.adr[0] : sensor.adr[0] + sensor.dim[0]]
