"""The interface of a simulator."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import unknown

_ODD = {"WARMSTART": "qacc_warmstart", "PLUGIN": "plugin_state"}
STATE: dict[str, mujoco.mjtState] = {  # the parts of MuJoCo's state, by their names in MjData
    _ODD.get(word := str(member)[8:]) or word.lower(): part
    for member, part in mujoco.mjtState.__members__.items()
    if member.startswith("mjSTATE_") and int(part).bit_count() == 1
}
MAIN = "qpos", "qvel", "act", "ctrl", "qacc_warmstart"  # those that `Physics` has by name


def initial_parts(model: mujoco.MjModel) -> dict[str, NDArray[np.float64]]:
    """Return the parts of MuJoCo's state that a model has beside the MAIN ones, in new MjData."""
    data, names = mujoco.MjData(model), [name for name in STATE if name not in MAIN]
    has = [name for name in names if mujoco.mj_stateSize(model, STATE[name])]
    return {name: np.array(getattr(data, name), float) for name in has}


class Physics(ABC):
    """N copies of one MuJoCo model on one device, advanced together, seen as torch tensors.

    The tensors are views of the simulator's own memory: reading one copies nothing, and writing
    one in place moves the robots. Never rebind them (`physics.qpos = ...` would silently detach
    from the simulator). `sensors` describes the state that *entered* the last physics step, as
    after C MuJoCo's `mj_step`; after a reset it holds the readings of the new state.
    """

    name: str  # of the simulator
    model: mujoco.MjModel
    num_worlds: int
    device: torch.device
    qpos: Tensor  # (N, nq) meters, radians
    qvel: Tensor  # (N, nv) m/s, rad/s
    act: Tensor  # (N, na) activations of actuators that have one (dyntype)
    ctrl: Tensor  # (N, nu)
    warmstart: Tensor  # (N, nv) initial guess of the constraint solver
    sensors: Tensor  # (N, nsensordata)
    # Everything else that future steps read, such as `time` and `mocap_pos`, by its name in MjData:
    # (N, ...) each, and what an episode starts with, (...).
    parts: dict[str, tuple[Tensor, Tensor]] = {}

    @abstractmethod
    def step(self) -> None:
        """Advance every world by one control step, holding `ctrl`."""

    def move_only(self, which: Tensor) -> None:
        """From now on, worlds outside of a mask (N,) bool may stay as they are, to save time."""
        assert which.shape == (self.num_worlds,)

    @abstractmethod
    def vary(self, fields: dict[str, np.ndarray]) -> None:
        """Give each world its own model, which differs in `fields` (N, ...), by name.

        Derived constants of the model are updated. Worlds keep their state.

        Raises:
            MorlaxError: the simulator cannot vary such a field between worlds.
        """

    @abstractmethod
    def keep(self, models: list[mujoco.MjModel]) -> None:
        """Keep models that differ from `model` in numbers only, for `choose`.

        Raises:
            MorlaxError: the simulator cannot vary a field in which they differ between worlds.
        """

    @abstractmethod
    def choose(self, rows: Tensor) -> None:
        """Give each world the kept model of its row (N,); worlds keep their state."""

    @abstractmethod
    def overflow(self) -> Tensor:
        """Return (N,) int32, non-zero where contacts or constraints overflowed their buffers."""

    @abstractmethod
    def remedy(self, bits: int) -> str:
        """Say how to avoid the overflow with the union `bits` of `overflow`."""

    def sensor(self, name: str) -> Tensor:
        """Return a view (N, dim) of one sensor's readings.

        Raises:
            MorlaxError: the model has no such sensor.
        """
        if name not in self._readings_of:
            raise unknown("sensor", name, self._readings_of)
        return self._readings_of[name]

    def part(self, name: str) -> Tensor:
        """Return a view (N, ...) of another part of MuJoCo's state, such as "mocap_pos".

        An episode starts with its value in new MjData.

        Raises:
            MorlaxError: the model has no such part.
        """
        if name not in self.parts:
            raise unknown("part of the state", name, self.parts)
        return self.parts[name][0]

    def _view_parts(self, view: Callable[[str], Tensor]) -> None:
        """Set `parts`; `view` returns the simulator's array of a name."""
        self.parts = {
            name: (values := view(name), torch.from_numpy(initial).to(values))
            for name, initial in initial_parts(self.model).items()
        }

    @cached_property
    def _readings_of(self) -> dict[str, Tensor]:
        found = [self.model.sensor(index) for index in range(self.model.nsensor)]
        return {x.name: self.sensors[:, x.adr[0] : x.adr[0] + x.dim[0]] for x in found}
