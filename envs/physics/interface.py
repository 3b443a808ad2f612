"""The interface of a simulator, and errors for models that it refuses."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..errors import MorlaxError, unknown, words

_ODD = {"WARMSTART": "qacc_warmstart", "PLUGIN": "plugin_state"}
STATE: dict[str, mujoco.mjtState] = {  # the parts of MuJoCo's state, by their names in MjData
    _ODD.get(word := str(member)[8:]) or word.lower(): part
    for member, part in mujoco.mjtState.__members__.items()
    if member.startswith("mjSTATE_") and int(part).bit_count() == 1
}
Fields = dict[str, np.ndarray]  # of models that differ, (N, ...) each, by their names in MjModel
MAIN = "qpos", "qvel", "act", "ctrl", "qacc_warmstart"  # those that `Physics` has by name

REMEDIES = {  # for what simulators say of a model
    r"mjSOL_": 'set <option solver="Newton"/>, or model.opt.solver in load_model',
    r"mjINT_": 'set <option integrator="implicitfast"/>, or model.opt.integrator in load_model',
    r"mjCONE_": 'set <option cone="pyramidal"/>, or model.opt.cone in load_model',
    r"mj(?:ENBL|DSBL)_(\w+)": "leave {} out of <flag>",
    r"Dense is": 'set <option jacobian="sparse"/>, or model.opt.jacobian in load_model',
    r"noslip": 'set <option noslip_iterations="0"/>, or model.opt.noslip_iterations in load_model',
    r"(\w+) plugins": "leave the {} plugins out",
    r"out of memory|overflow": 'raise <size memory="100M"/> in the MJCF',
}
REFUSALS = NotImplementedError, ValueError, AttributeError, TypeError, KeyError
STOPS = mujoco.FatalError, RuntimeError  # while C MuJoCo steps


@contextmanager
def explained(simulator: str, errors: tuple[type[Exception], ...] = REFUSALS) -> Iterator[None]:
    """Raise MorlaxError, with a remedy, where a simulator refuses a model."""
    try:
        yield
    except errors as error:
        if "bad_alloc" in str(error):
            raise MemoryError from None
        reason = words(error).removeprefix("NotImplementedError: ").removeprefix("ValueError: ")
        reason = reason.rstrip(".")
        remedy = "leave this out of the MJCF, or choose the other simulator with --backend"
        for pattern, advice in REMEDIES.items():
            if match := re.search(pattern, reason):
                remedy = advice.format(*(each.lower() for each in match.groups()))
                break
        sentence = f"{simulator} cannot simulate this model ({reason}): {remedy}."
        raise MorlaxError(sentence) from error


class Physics(ABC):
    """N copies of one MuJoCo model on one device, advanced together, seen as torch tensors.

    The tensors are views of the simulator's own memory: reading one copies nothing, and writing
    one in place moves the robots. They cannot be rebound. `sensors` describes the state that
    *entered* the last physics step, as after C MuJoCo's `mj_step`; after a reset it holds the
    readings of the new state.
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

    def __setattr__(self, name: str, value: object) -> None:
        current = getattr(self, name, None)
        if isinstance(current, Tensor) and value is not current:
            raise MorlaxError(
                f"physics.{name} is the simulator's own memory, which no other tensor can replace: "
                f"write into it, physics.{name}.copy_(...)."
            )
        super().__setattr__(name, value)

    @abstractmethod
    def step(self) -> None:
        """Advance every world by one control step, holding `ctrl`."""

    def move_only(self, which: Tensor) -> None:
        """From now on, worlds outside of a mask (N,) bool may stay as they are, to save time."""
        assert which.shape == (self.num_worlds,)

    @abstractmethod
    def vary(self, fields: Fields) -> None:
        """Give each world its own model, which differs in `fields` (N, ...), by name.

        Derived constants of the model are updated. Worlds keep their state.
        """

    @abstractmethod
    def keep(self, models: list[mujoco.MjModel]) -> None:
        """Keep models that differ from `model` in numbers only, for `choose`."""

    @abstractmethod
    def choose(self, rows: Tensor) -> None:
        """Give each world the kept model of its row (N,); worlds keep their state."""

    def overflow(self) -> Tensor:
        """Return (N,) int32, non-zero where contacts or constraints overflowed their buffers."""
        return torch.zeros(self.num_worlds, dtype=torch.int32, device=self.device)

    def remedy(self, bits: int) -> str:
        """Say how to avoid the overflow with the union `bits` of `overflow`."""
        return ""

    def sensor(self, name: str) -> Tensor:
        """Return a view (N, dim) of one sensor's readings."""
        if name not in self._readings_of:
            raise unknown("sensor", name, self._readings_of)
        return self._readings_of[name]

    def part(self, name: str) -> Tensor:
        """Return a view (N, ...) of another part of MuJoCo's state, such as "mocap_pos".

        An episode starts with its value in new MjData.
        """
        if name not in self.parts:
            raise unknown("part of the state", name, self.parts)
        return self.parts[name][0]

    def _view_state(self, view: Callable[[str], Tensor]) -> None:
        """Set the tensors of the state that every model has, and `parts`, to views by name."""
        self.qpos, self.qvel = view("qpos"), view("qvel")
        self.ctrl, self.warmstart = view("ctrl"), view("qacc_warmstart")
        data, self.parts = mujoco.MjData(self.model), {}
        for name in (name for name in STATE if name not in MAIN):
            if mujoco.mj_stateSize(self.model, STATE[name]):
                initial = torch.from_numpy(np.array(getattr(data, name), float))
                self.parts[name] = view(name), initial.to(view(name))

    @cached_property
    def _readings_of(self) -> dict[str, Tensor]:
        sensors = [self.model.sensor(index) for index in range(self.model.nsensor)]
        return {x.name: self.sensors[:, x.adr[0] : x.adr[0] + x.dim[0]] for x in sensors}
