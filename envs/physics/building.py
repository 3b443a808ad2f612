"""The choice of a simulator."""

import mujoco
import torch

from ..errors import MorlaxError
from .interface import Physics


def build_physics(
    model: mujoco.MjModel,
    num_worlds: int,
    device: torch.device,
    backend: str | None,
    substeps: int,
    *,
    nconmax: int,
    njmax: int,
    deterministic: bool,
) -> Physics:
    """Build N copies of a model on the simulator `backend`: "warp", "mujoco" or None (by device).

    Each simulator is imported only when it is used.

    Raises:
        MorlaxError: C MuJoCo is asked to run on a GPU.
    """
    backend = backend or ("warp" if device.type == "cuda" else "mujoco")
    if backend == "mujoco":
        if device.type != "cpu":
            raise MorlaxError(f"C MuJoCo runs on the CPU: on {device}, use backend 'warp'.")
        from .mujoco import MujocoPhysics

        return MujocoPhysics(model, num_worlds, substeps)
    from .warp import WarpPhysics

    return WarpPhysics(model, num_worlds, device, substeps, nconmax, njmax, deterministic)
