"""Physics on MuJoCo Warp, in float32: on CUDA, and on the CPU for tests."""

import dataclasses
from functools import partial
from operator import attrgetter

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mujoco_warp._src.types import OverflowType  # public since 4.0
from torch import Tensor

from ..errors import MorlaxError, line
from . import compiling
from .interface import Fields, Physics, explained
from .mujoco import cannot_vary, varying

wp.config.log_level = wp.LOG_WARNING  # Warp reports every kernel it loads

# A solver that stops at its iteration limit is not an error: the task sets the limits.
_LIMITS = sum(getattr(OverflowType, name, 0) for name in ("ITERATIONS", "LS_ITERATIONS"))
_CONSTRAINTS = OverflowType.NEFC | OverflowType.NJMAX_NNZ
# For these constraints MuJoCo Warp computes accelerations from the previous step's velocities.
_ANCHORED = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
_FIELDS = dataclasses.fields(mjw.Model)
_VARIABLE = {field.name for field in _FIELDS if getattr(field.type, "shape", ())[:1] == ("*",)}


class WarpPhysics(Physics):
    """MuJoCo Warp with torch views of its arrays.

    On CUDA a step only enqueues work, and Python is most of its cost: record the caller in a CUDA
    graph. On the CPU the step records itself once and is then replayed.
    """

    name = "MuJoCo Warp"

    def __init__(
        self,
        model: mujoco.MjModel,
        num_worlds: int,
        device: torch.device,
        substeps: int,
        nconmax: int,
        njmax: int,
        deterministic: bool = False,
    ):
        self.model, self.num_worlds, self.device = model, num_worlds, device
        self.substeps, self.nconmax, self.njmax = substeps, nconmax, njmax
        try:
            wp.init()
        except OSError as error:  # such as in a container without a home
            raise MorlaxError(
                f"Warp cannot keep compiled kernels in {error.filename} ({error.strerror}): set "
                "WARP_CACHE_PATH to a folder that you may write to."
            ) from None
        with wp.ScopedDevice(str(device)):
            with explained(self.name):
                self._model = mjw.put_model(model)
            self._model.opt.warn_overflow = 0  # would print from kernels; we read `overflow`
            if deterministic:
                if not hasattr(self._model.opt, "deterministic"):
                    raise MorlaxError(
                        f"MuJoCo Warp {mjw.__version__} has no deterministic mode: leave "
                        "--deterministic out, or install mujoco-warp 4.0 or newer."
                    )
                self._model.opt.deterministic = True
            if device.type == "cuda":
                # Early exit of the solver costs a conditional node in the graph, which pays off
                # only if it can save many iterations.
                self._model.opt.graph_conditional = model.opt.iterations > 6
            self._data = data = self._make_data(num_worlds)
            with explained(self.name):
                compiling.start(partial(mjw.step, self._model, self._make_data(1)))
            wp.synchronize_device()  # Warp frees the spare data on another stream
        self._view_state(lambda name: wp.to_torch(getattr(data, name)))
        self.act, self.sensors = wp.to_torch(data.act), wp.to_torch(data.sensordata)
        if np.isin(model.eq_type, _ANCHORED).any():
            for i, values in enumerate(map(wp.to_torch, (data.cvel, data.cdof_dot))):
                self.parts[f"leftover.{i}"] = values, torch.zeros_like(values[0])
        self._overflow = wp.to_torch(data.overflow)
        self._kept: list[tuple[Tensor, Tensor]] = []  # (D, ...) of all models, (N, ...) of worlds
        self._launched = False
        self._replay: wp.Graph | None = None

    def _make_data(self, num_worlds: int) -> mjw.Data:
        nconmax, njmax = self.nconmax, self.njmax
        try:
            return mjw.make_data(self.model, nworld=num_worlds, nconmax=nconmax, njmax=njmax)
        except ValueError as error:  # an array has 2^31 entries or more
            raise MorlaxError(
                f"MuJoCo Warp cannot hold {num_worlds} worlds with task.nconmax {nconmax} and "
                f"task.njmax {njmax}: {line(error)}"
            ) from None

    def step(self) -> None:
        if self.device.type == "cuda":
            self._advance()
        elif self._replay is None:
            self._advance()  # compiles the kernels once per machine and loads them
            with wp.ScopedCapture(device="cpu") as capture:
                self._advance()
            self._replay = capture.graph
        else:
            wp.capture_launch(self._replay)

    def _advance(self) -> None:
        if not self._launched:
            compiling.finish()
            self._launched = True
        with wp.ScopedDevice(str(self.device)):
            for _ in range(self.substeps):
                mjw.step(self._model, self._data)

    def vary(self, fields: Fields) -> None:
        for name, values in varying(self.model, self.num_worlds, fields).items():
            if name not in _VARIABLE:
                if name in fields:
                    raise cannot_vary(self.name, name)
                continue  # a constant that this simulator does not use
            self._of_worlds(name).assign(values)
        wp.synchronize_device(str(self.device))  # torch's stream does not wait for Warp's

    def _of_worlds(self, name: str) -> wp.array:
        """Return a field of the model with a row for each world: a recorded graph keeps it."""
        array = getattr(self._model, name)
        if len(array) != self.num_worlds:
            shape = (self.num_worlds, *array.shape[1:])
            array = wp.empty(shape, dtype=array.dtype, device=array.device)
            setattr(self._model, name, array)
        return array

    def keep(self, models: list[mujoco.MjModel]) -> None:
        self._kept = []
        names = [field.name for field in _FIELDS if hasattr(self.model, field.name)]  # sizes first
        names += [f"opt.{name}" for name in dir(self.model.opt) if name[0] != "_"]
        for name in names:
            value = attrgetter(name)
            values = np.stack([value(model) for model in models])
            # nothing may sleep, so dof_length is unused
            if name in ("opt", "dof_length") or (values == value(self.model)).all():
                continue
            if name not in _VARIABLE:
                raise MorlaxError(
                    f"{self.name} cannot vary {name!r} between worlds, but designs differ in it: "
                    "change other numbers of the body."
                )
            array = self._of_worlds(name)
            rows = wp.array(values, dtype=array.dtype, device=array.device)
            self._kept.append((wp.to_torch(rows), wp.to_torch(array)))
        wp.synchronize_device(str(self.device))  # torch's stream does not wait for Warp's
        self.choose(torch.zeros(self.num_worlds, dtype=torch.int64, device=self.device))

    def choose(self, rows: Tensor) -> None:
        for kept, values in self._kept:
            torch.index_select(kept, 0, rows, out=values)

    def overflow(self) -> Tensor:
        return self._overflow & ~int(_LIMITS)

    def remedy(self, bits: int) -> str:
        if bits & int(_CONSTRAINTS):
            return f"raise --task.njmax above {self.njmax} (constraint rows of a world)"
        return f"raise --task.nconmax above {self.nconmax} (contacts of a world)"
