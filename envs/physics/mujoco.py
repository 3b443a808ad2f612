"""Physics on C MuJoCo: many worlds on a thread pool, in float64, and models that differ."""

import copy
import gc
import os
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from ..errors import MorlaxError
from .interface import STATE, STOPS, Fields, Physics, explained


class PythonBatch:
    """N worlds, stepped one after the other, with what we use of `mujoco.batch.Batch`."""

    def __init__(self, model: mujoco.MjModel, nsim: int):
        self._model, self._models = model, [model] * nsim
        self._datas = [mujoco.MjData(model) for _ in range(nsim)]
        self._bound: dict[str, np.ndarray] = {}
        self._expanded: dict[str, np.ndarray] = {}

    def bind(self, name: str) -> np.ndarray:
        """Return the array `name` of MjData for all worlds, (N, ...), kept up to date."""
        values = np.stack([getattr(data, name) for data in self._datas])
        return self._bound.setdefault(name, values)

    def step(self, ids: np.ndarray | None, nstep: int) -> None:
        """Advance the worlds of these indices (None: all) by `nstep` time steps."""
        for world in range(len(self._datas)) if ids is None else ids:
            data = self._datas[world]
            for name in self._bound.keys() & STATE:
                setattr(data, name, self._bound[name][world])
            mujoco.mj_step(self._models[world], data, nstep)
            for name, values in self._bound.items():
                values[world] = getattr(data, name)

    def expand(self, name: str) -> np.ndarray:
        """Return the array `name` of MjModel for all worlds, (N, ...), to write to."""
        if self._models[0] is self._model:
            self._models = [copy.copy(self._model) for _ in self._models]
        self._expanded[name] = self.expanded(name)
        return self._expanded[name]

    def expanded(self, name: str) -> np.ndarray:
        """Return the array `name` of MjModel of all worlds, (N, ...)."""
        return np.stack([getattr(model, name) for model in self._models])

    def set_models(self, models: list[mujoco.MjModel]) -> None:
        """Run each world on a model of its own."""
        self._models = models

    def set_const(self) -> None:
        """Put what was written into the models and update the constants that follow."""
        for world, (model, data) in enumerate(zip(self._models, self._datas, strict=True)):
            for name, values in self._expanded.items():
                getattr(model, name)[:] = values[world]
            mujoco.mj_setConst(model, data)


try:
    from mujoco.batch import MODEL_FIELDS, Batch
except ModuleNotFoundError:
    _ONE = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    MODEL_FIELDS = tuple(n for n in dir(_ONE) if isinstance(getattr(_ONE, n, None), np.ndarray))
    Batch = PythonBatch  # pyright: ignore[reportAssignmentType]
if hasattr(os, "register_at_fork"):  # to free a batch without its threads hangs in a fork's child
    os.register_at_fork(after_in_child=gc.freeze)


def vary(batch: Any, fields: Fields) -> None:
    """Write `fields` (N, ...) into the models of `batch` and update the derived constants."""
    for name, values in fields.items():
        batch.expand(name)[:] = values
    batch.set_const()


def varying(model: mujoco.MjModel, num_worlds: int, fields: Fields) -> Fields:
    """Return `fields` and every derived constant that they change in some world, (N, ...)."""
    batch, varied = Batch(model, nsim=num_worlds), {}
    vary(batch, fields)
    for name in MODEL_FIELDS:
        values = batch.expanded(name)
        if values is not None and (name in fields or (values != getattr(model, name)).any()):
            varied[name] = values.copy()
    return varied


def cannot_vary(simulator: str, field: str) -> MorlaxError:
    """Return the error for a field that a simulator shares between worlds."""
    return MorlaxError(
        f"task.randomization.fields: {simulator} cannot vary {field!r} between worlds: name an "
        "array of numbers of mujoco.MjModel that this robot has, such as dof_damping."
    )


class MujocoPhysics(Physics):
    """C MuJoCo through `mujoco.batch`; results do not depend on the number of threads."""

    name = "C MuJoCo"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, substeps: int):
        # A blown-up world must stay as it is until its environment detects and resets it. It is
        # reported there, not in a MUJOCO_LOG.TXT in the working directory.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        mujoco.set_mju_user_warning(lambda message: None)
        self.model, self.num_worlds, self.device = model, num_worlds, torch.device("cpu")
        self.substeps, self._process = substeps, os.getpid()
        with explained(self.name):
            self._batch = Batch(model, nsim=num_worlds)
        self._view_state(self._view)
        nothing = torch.zeros(num_worlds, 0, dtype=torch.float64)
        self.act = self._view("act") if model.na else nothing
        # MuJoCo's sensor readings are read-only, but a reset has to write them
        self.sensors = torch.zeros(num_worlds, model.nsensordata, dtype=torch.float64)
        self._readings = self._batch.bind("sensordata") if model.nsensordata else None
        self._kept: list[mujoco.MjModel] = []
        self._moving: np.ndarray | None = None  # indices of worlds; None: all

    def _view(self, name: str) -> Tensor:
        return torch.from_numpy(self._batch.bind(name))

    def step(self) -> None:
        forked = self._process != os.getpid() and Batch is not PythonBatch
        if forked and self.num_worlds > 1:  # it would wait for its threads
            raise MorlaxError(
                "a forked process cannot step worlds of its parent, whose threads it lacks: make "
                "the worlds in the process that steps them."
            )
        with explained(self.name, STOPS):
            self._batch.step(self._moving, nstep=self.substeps)
        if self._readings is not None:
            self.sensors.numpy()[:] = self._readings

    def move_only(self, which: Tensor) -> None:
        self._moving = None if which.all() else which.numpy().nonzero()[0]

    def vary(self, fields: Fields) -> None:
        vary(self._batch, fields)

    def keep(self, models: list[mujoco.MjModel]) -> None:
        for model in models:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._kept = models

    def choose(self, rows: Tensor) -> None:
        self._batch.set_models([self._kept[row] for row in rows.tolist()])
