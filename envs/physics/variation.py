"""Model fields that differ between worlds: friction, masses, motor strength and others."""

import mujoco
import numpy as np

from ..errors import MorlaxError
from .batch import MODEL_FIELDS, Batch


def apply(batch: Batch, fields: dict[str, np.ndarray]) -> None:
    """Write `fields` (N, ...) into the models of `batch` and update the derived constants."""
    for name, values in fields.items():
        batch.expand(name)[:] = values
    batch.set_const()


def varying(
    model: mujoco.MjModel, num_worlds: int, fields: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return `fields` and every derived constant that they change in some world, (N, ...)."""
    batch = Batch(model, nsim=num_worlds)
    apply(batch, fields)
    found = {name: batch.expanded(name) for name in MODEL_FIELDS}
    return {
        name: values.copy()
        for name, values in found.items()
        if values is not None and (name in fields or (values != getattr(model, name)).any())
    }


def cannot(simulator: str, field: str) -> MorlaxError:
    """Return the error for a field that a simulator shares between worlds."""
    return MorlaxError(
        f"task.randomization.fields: {simulator} cannot vary {field!r} between worlds: name an "
        "array of numbers of mujoco.MjModel that this robot has, such as dof_damping."
    )
