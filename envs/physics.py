"""What an environment may ask of a simulator."""

from abc import ABC, abstractmethod

import mujoco
import torch
from torch import Tensor


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

    @abstractmethod
    def step(self) -> None:
        """Advance every world by one control step, holding `ctrl`."""

    @abstractmethod
    def overflow(self) -> Tensor:
        """(N,) int32, non-zero where contacts or constraints no longer fitted their buffers."""

    @abstractmethod
    def remedy(self, bits: int) -> str:
        """What to do about the union `bits` of what `overflow` returned, in words."""

    def sensor(self, name: str) -> Tensor:
        """A view (N, dim) of one sensor's readings."""
        sensor = self.model.sensor(name)
        return self.sensors[:, sensor.adr[0] : sensor.adr[0] + sensor.dim[0]]

    def reset(self, done: Tensor, qpos: Tensor, qvel: Tensor, sensors: Tensor) -> None:
        """Put the worlds where `done` (N,) into the given state, leaving the others alone.

        `qpos`, `qvel` and `sensors` have a row for each world, or one row for all.
        """
        done = done[:, None]
        torch.where(done, qpos, self.qpos, out=self.qpos)
        torch.where(done, qvel, self.qvel, out=self.qvel)
        self.warmstart.masked_fill_(done, 0.0)
        if self.sensors.shape[1]:
            torch.where(done, sensors, self.sensors, out=self.sensors)

    def blown_up(self) -> Tensor:
        """(N,) True where the state is no longer finite."""
        # a sum is finite only if all it adds is, and only what is finite times zero is zero:
        # five kernels where two `isfinite` and `all` take twelve
        return (self.qpos.sum(-1) + self.qvel.sum(-1)) * 0 != 0
