"""Physics on C MuJoCo: many worlds on a thread pool, in float64."""

import mujoco
import numpy as np
import torch
from torch import Tensor

from .batch import Batch, vary
from .interface import Physics


class MujocoPhysics(Physics):
    """C MuJoCo through `mujoco.batch`; results do not depend on the number of threads."""

    name = "C MuJoCo"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, substeps: int):
        # A blown-up world must stay as it is until its environment detects and resets it. It is
        # reported there, not in a MUJOCO_LOG.TXT in the working directory.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        mujoco.set_mju_user_warning(lambda message: None)
        self.model, self.num_worlds, self.device = model, num_worlds, torch.device("cpu")
        self.substeps = substeps
        try:
            self._batch = Batch(model, nsim=num_worlds)
        except ValueError as error:
            if "bad_alloc" in str(error):
                raise MemoryError from None
            raise
        self.qpos = torch.from_numpy(self._batch.bind("qpos"))
        self.qvel = torch.from_numpy(self._batch.bind("qvel"))
        self.ctrl = torch.from_numpy(self._batch.bind("ctrl"))
        self.act = (
            torch.from_numpy(self._batch.bind("act"))
            if model.na
            else torch.zeros(num_worlds, 0, dtype=torch.float64)
        )
        self.warmstart = torch.from_numpy(self._batch.bind("qacc_warmstart"))
        # MuJoCo's sensor readings are read-only, but a reset has to write them
        self.sensors = torch.zeros(num_worlds, model.nsensordata, dtype=torch.float64)
        self._readings = self._batch.bind("sensordata") if model.nsensordata else None
        self._no_overflow = torch.zeros(num_worlds, dtype=torch.int32)

    def step(self) -> None:
        self._batch.step(nstep=self.substeps)
        if self._readings is not None:
            self.sensors.numpy()[:] = self._readings

    def vary(self, fields: dict[str, np.ndarray]) -> None:
        vary(self._batch, fields)

    def overflow(self) -> Tensor:
        return self._no_overflow  # C MuJoCo grows its buffers as needed

    def remedy(self, bits: int) -> str:
        return ""
